"""A camera's controls: automatic exposure, gain, white balance and focus switched off, what is asked for set, read back, restored.

A camera that adjusts itself changes what a code is worth from frame to frame, and no driver says by how much.
"""

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from vemlight.errors import UserError
from vemlight.files import notice

MANUAL = {  # ids of what adjusts itself (linux/v4l2-controls.h), and the value that stops it
    0x009A0901: 1,  # exposure: manual mode
    0x009A0903: 0,  # frame rate lowered in the dark
    0x00980912: 0,  # gain
    0x0098090C: 0,  # white balance
    0x009A0914: 0,  # white balance presets: manual
    0x009A0918: 0,  # ISO sensitivity: manual
    0x009A090C: 0,  # focus
    0x00980918: 0,  # exposure times in steps of the mains' half wave
    0x0098091C: 0,  # compensation of light from behind
    0x009A0915: 0,  # wide dynamic range
    0x00980920: 0,  # brightness
    0x00980919: 0,  # hue
}
EXPOSURE = 0x009A0902  # exposure_time_absolute, in units of EXPOSURE_UNIT_S
EXPOSURE_UNIT_S = 1e-4
EXPOSURE_NAME = "exposure_time_absolute"  # as V4L2 has it; in the settings, the exposure of any camera
DISABLED, READ_ONLY, WRITE_ONLY = 0x0001, 0x0004, 0x0040  # flags
INTEGER, BOOLEAN, MENU, INTEGER_MENU = 1, 2, 3, 9  # types whose value is one whole number
CLASSES = (0x00980000, 0x009A0000)  # of user and camera controls; others set up codecs and tests


class Control(NamedTuple):
    """One control of a camera. name: as v4l2-ctl prints it."""

    id: int
    name: str
    minimum: int
    maximum: int
    flags: int


def controls_of(device: int) -> dict[str, Control]:
    """The controls of an open camera that have one number each, by name."""
    from linuxpy.video import device as v4l2

    found = {}
    for raw in _queried(v4l2, device):
        if raw.type in (INTEGER, BOOLEAN, MENU, INTEGER_MENU) and raw.id & 0x0FFF0000 in CLASSES and not raw.flags & DISABLED:
            name = re.sub(r"[^a-z0-9]+", "_", raw.name.decode(errors="replace").lower()).strip("_")
            found[name] = Control(int(raw.id), name, int(raw.minimum), int(raw.maximum), int(raw.flags))
    return found


def _queried(v4l2: Any, device: int) -> Iterator[Any]:
    try:
        yield from v4l2.iter_read_controls(device)
    except OSError:  # a driver without controls
        return


class CameraControls:
    """The controls of an open camera, while they are ours. values: what was read back, by name."""

    time_control, unit_s = EXPOSURE_NAME, EXPOSURE_UNIT_S

    def __init__(self, device: int, path: str, wanted: Mapping[str, int]) -> None:
        """Stops what adjusts itself and sets what is `wanted`; notices tell what did not obey.

        Raises UserError for a control that the camera does not have, and for a value out of its range.
        """
        self._device, self._path = device, path
        self._controls = controls_of(device)
        for name, value in wanted.items():
            self._check(name, value)
        self._before = {name: value for name in self._controls if (value := self._read(name)) is not None}
        automatic = {c.name: MANUAL[c.id] for c in self._controls.values() if c.id in MANUAL and not c.flags & (READ_ONLY | WRITE_ONLY)}
        asked = {**automatic, **wanted}
        for name, value in asked.items():
            if self._read(name) != value:
                self._set(name, value)
        self.values = {name: value for name in self._controls if (value := self._read(name)) is not None}
        refused = [name for name, value in asked.items() if self.values.get(name) != value]
        if refused:
            told = ", ".join(f"{name} is {self.values.get(name, 'not readable')}" for name in refused)
            notice(f"{path}: does not obey: {told}; its light may change by itself")
        if self.exposure_s is None and "exposure" not in " ".join(self._controls):
            notice(f"{path}: has no control for its exposure; where it adjusts itself, its light is right in proportion alone")

    @property
    def exposure_s(self) -> float | None:
        """The exposure time that was read back, None where the camera tells none."""
        name = next((control.name for control in self._controls.values() if control.id == EXPOSURE), None)
        return self.values[name] * EXPOSURE_UNIT_S if name in self.values else None

    def limits(self, name: str) -> tuple[int, int]:
        """The least and the largest value of a control. Raises UserError for one that the camera does not have."""
        self._check(name, None)
        return self._controls[name].minimum, self._controls[name].maximum

    def write(self, name: str, value: int) -> None:
        """Sets a control without asking whether it obeyed."""
        self._set(name, value)

    def written(self, name: str, value: int) -> int | None:
        """Sets a control; returns what is read back."""
        self._set(name, value)
        return self._read(name)

    def restore(self) -> None:
        """Sets everything to what it was. Controls that something automatic has taken over again need no value."""
        for name, value in sorted(self._before.items(), key=lambda row: self._controls[row[0]].id in MANUAL):
            if self._read(name) != value:
                self._set(name, value)

    def _check(self, name: str, value: int | None) -> None:
        control = self._controls.get(name)
        if control is None:
            names = ", ".join(self._controls) or "none"
            raise UserError(f"{self._path}: has no control {name[:40]} but {names}; correct --control or [capture] controls")
        if value is not None and not control.minimum <= value <= control.maximum:
            raise UserError(f"{self._path}: {name} = {value} is not in {control.minimum} .. {control.maximum}; choose a number in it")

    def _read(self, name: str) -> int | None:
        from linuxpy.video import device as v4l2

        try:
            return int(v4l2.get_control(self._device, self._controls[name].id))
        except OSError:
            return None

    def _set(self, name: str, value: int) -> None:
        from linuxpy.video import device as v4l2

        with suppress(OSError):  # whether it obeyed is read back
            v4l2.set_control(self._device, self._controls[name].id, value)
