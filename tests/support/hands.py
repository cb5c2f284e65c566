"""What a hand does on the page of a browser."""

from tests.support.viewer_process import SimulatedServices
from vemlight.runtime import wire


def drag(page, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Presses at one place of the window, moves, and lets go at another; CSS pixels."""
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    page.mouse.move(*end)
    page.mouse.up()


def newest(simulated: SimulatedServices) -> wire.ControlMessage:
    """What was chosen last."""
    return simulated.controls[-1]
