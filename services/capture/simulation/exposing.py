"""The virtual camera's exposure control: what is written to it takes effect some frames later, as with real drivers."""

import itertools

from vemlight.capture.exposure_cycle import ExposureCycle


def exposures_of_frames(cycle: ExposureCycle, control_delay: int, received: list[int], count: int) -> list[float]:
    """The exposure of each frame 0 .. count - 1, s.

    control_delay: frames from a command to its effect, 1 or more. received: numbers of the frames that are not lost; after each of them a
    program writes the next exposure (see ExposureCycle), and after a lost one it writes nothing. Before the first command has arrived the
    exposure is the camera's own, none of those that were asked for.
    """
    longer, shorter = cycle.exposures[:2]
    effects = {control_delay: cycle.exposures[cycle.first]}
    arrived = set(received)
    for number, k in zip(itertools.count(1), sorted(arrived), strict=False):
        ahead = cycle.asked_after(number)
        if ahead is not None:
            effects[k + control_delay] = cycle.exposures[ahead]
    exposures, current = [], (longer * shorter) ** 0.5
    for k in range(count):
        current = effects.get(k, current)
        exposures.append(current)
    return exposures
