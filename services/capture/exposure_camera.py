"""A camera whose exposure changes from frame to frame: the control is written ahead, and what comes is merged."""

import json
from typing import Any

import numpy as np

from vemlight.capture.camera_controls import EXPOSURE_NAME, CameraControls
from vemlight.capture.colour_coding import LOWEST, PER_SIGNAL, ColourCoding, white_entry
from vemlight.capture.exposure_cycle import SETTLING, ExposureCycle
from vemlight.capture.exposure_merge import CLIPPED, CodeValues
from vemlight.capture.exposure_recording import EXPOSURE, EXPOSURES, checked_exposures, exposures_text
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.genicam_controls import GenicamControls
from vemlight.capture.live_brackets import LiveBrackets
from vemlight.capture.mosaic import Mosaic
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.settings import Capture

ALIKE = 0.05  # at most, between an exposure that a frame tells and the one of the cycle that it is; 0.02 to 0.2 do


def values_from_coding(coding: ColourCoding, bits: int, exposure_s: float) -> CodeValues:
    """What the entries of a coding's table are worth, of codes of so many bits. exposure_s: for which the table holds."""
    clipped, white = (int(np.ceil(entry)) for entry in ((CLIPPED - LOWEST) * PER_SIGNAL, white_entry(bits)))
    light = np.maximum.accumulate(coding.table.astype(np.float64)) * exposure_s
    return CodeValues(light, clipped, white, 1, coding.rec709_from_light, coding.luminance_scale, PER_SIGNAL / (2**bits - 1))


class ExposureCamera:
    """The exposures of an open camera: asked for in turn, recognised and merged."""

    def __init__(
        self,
        settings: Capture,
        maker: FrameMaker,
        name: str,
        controls: CameraControls | GenicamControls,
        values: CodeValues,
        mosaic: Mosaic | None,
        fps: float,
    ) -> None:
        """Tries each exposure and sets the first one. Raises UserError for a control or exposures that the camera does not have."""
        asked = settings.exposure_control
        self._control = controls.time_control if asked == EXPOSURE_NAME else asked
        self._unit_s = controls.unit_s if self._control == controls.time_control else 0.0  # 0: exposures are the control's own counts
        counts = self._counts(name, settings.exposures, *controls.limits(self._control))
        unit = self._unit_s or 1.0
        found = {count: controls.written(self._control, count) for count in counts}
        if refused := [count for count, value in found.items() if value is None or value <= 0]:
            raise UserError(f"{name}: does not take {self._control} = {refused[0]}; choose other exposures")
        for count, value in found.items():
            if value != count:
                notice(f"{name}: makes {self._control} = {value} of {count}; its exposures are read back")
        self._count_by_exposure = {value * unit: count for count, value in found.items() if value is not None}
        self.cycle = ExposureCycle(checked_exposures(name, tuple(self._count_by_exposure)))
        if self._unit_s and fps * self.cycle.exposures[0] > 1:
            longest = f"an exposure of {self.cycle.exposures[0]:g} s is longer than a frame at {fps:g} a second"
            notice(f"{name}: {longest}; frames may come later")
        self._received = 0
        self._live = LiveBrackets(maker, name, self.cycle, values, mosaic)
        self.write(controls, self.cycle.first)

    def _counts(self, name: str, exposures: tuple[float, ...], least: float, most: float) -> list[int]:
        """The values of the control, each in its limits."""
        counts = []
        for exposure in exposures:
            unit = self._unit_s or 1.0
            count = exposure / unit
            if not least <= round(count) <= most or round(count) < 1:
                reach = f"{max(least, 1) * unit:g} to {most * unit:g}{' s' if self._unit_s else ''}"
                raise UserError(f"{name}: an exposure of {exposure:g} is not in its {reach} of {self._control}; choose one in it")
            counts.append(round(count))
        return counts

    def write(self, controls: CameraControls | GenicamControls, number: int) -> None:
        """Asks for the exposure of that number."""
        controls.write(self._control, self._count_by_exposure[self.cycle.exposures[number]])

    def received(self, controls: CameraControls | GenicamControls) -> bool:
        """To be called for each frame, before it is used: asks for a later one's exposure. Whether this one is to be used."""
        self._received += 1
        ahead = self.cycle.asked_after(self._received)
        if ahead is not None:
            self.write(controls, ahead)
        return self._received >= SETTLING

    def frame(self, codes: np.ndarray, time_s: float, exposure_s: float | None = None) -> tuple[Frame, dict[str, Any]]:
        """The map of a frame and those before it, and the attributes of a recorded frame's header.

        exposure_s: where the camera tells each frame's; else it is recognised from the picture, as where it tells none of those asked for.
        """
        told = None
        if exposure_s and self._unit_s:
            nearest = min(range(len(self.cycle.exposures)), key=lambda n: abs(exposure_s / self.cycle.exposures[n] - 1))
            told = nearest if abs(exposure_s / self.cycle.exposures[nearest] - 1) < ALIKE else None
        frame, number = self._live.frame(codes, time_s, told)
        exposure = self.cycle.exposures[number]
        return frame, {EXPOSURES: exposures_text(self.cycle.exposures), EXPOSURE: repr(exposure)}

    def without_exposure(self, attributes: dict[str, Any]) -> dict[str, Any]:
        """A recorded frame's attributes without the exposure that the controls had when they were read back."""
        held = {name: value for name, value in json.loads(attributes.get("vemlight:controls", "{}")).items() if name != self._control}
        kept = {key: value for key, value in attributes.items() if key not in ("vemlight:controls", "expTime")}
        return kept | ({"vemlight:controls": json.dumps(held)} if held else {})
