"""Frames of changing exposure as they come, each made into a map of all light: merged with the newest frame of every other exposure."""

import numpy as np

from vemlight.capture.exposure_cycle import ExposureCycle, ExposureRecogniser
from vemlight.capture.exposure_merge import CodeValues, clipped_pixels, count_from, merge_tables, merged
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.mosaic import Mosaic
from vemlight.capture.strong_lights import StrongLight, add_lights, ceiling, clipped_part, followed, moving, strong_lights, window_on
from vemlight.files import notice

FAINT_WEIGHT = 1e-30  # of what is above the ceiling: it counts where nothing else does


class LiveBrackets:
    """Merges the frames of a camera whose exposure changes from frame to frame."""

    def __init__(self, maker: FrameMaker, name: str, cycle: ExposureCycle, values: CodeValues, mosaic: Mosaic | None) -> None:
        """name: of the camera, for notices and errors."""
        self._maker, self._name, self._exposures, self._values = maker, name, cycle.exposures, values
        self._mosaic: Mosaic | None = mosaic
        self._step = 1 if mosaic in (None, "mono") else 2  # pixels between two of one colour
        self._first = cycle.first
        self._stack = np.zeros(0, np.uint16)  # (exposures, height, width) or (.., 3): the newest frame of each
        self._newest: dict[int, np.ndarray] = {}  # those of it that there are
        self._clipped: dict[int, np.ndarray] = {}
        self._tables: dict[tuple[int, ...], np.ndarray] = {}
        self._lights: list[StrongLight] = []
        self._saturated = 0
        self._image = np.zeros(0, np.float32)
        self._recogniser: ExposureRecogniser | None = None

    def frame(self, codes: np.ndarray, time_s: float, exposure: int | None = None) -> tuple[Frame, int]:
        """The map with this frame in it, and the number of the frame's exposure. codes: (height, width) of the mosaic, or (.., 3).

        exposure: its number where it is known, else it is recognised; the very first is the cycle's first. Raises UserError as
        `FrameMaker.frame`.
        """
        spans = self._maker.spans(self._name, codes.shape, self._mosaic)
        if self._recogniser is None:
            self._recogniser = ExposureRecogniser(self._values, self._exposures, spans)
            self._image = np.zeros(codes.shape, np.float32)
            self._stack = np.zeros((len(self._exposures), *codes.shape), codes.dtype)
        if exposure is None:
            exposure = self._first if not self._newest else self._recogniser.recognised(codes, self._image, min(self._newest))
        self._take(codes, exposure, spans)
        self._merge(spans)
        shortest = max(self._newest) == len(self._exposures) - 1
        clipped = shortest and self._saturated > 0
        is_still = exposure == len(self._exposures) - 1  # strong lights are where that frame shows them

        def made(gain: float) -> Frame:
            image = self._with_bright_lights(gain) if gain else self._image
            frame = self._maker.frame_from_radiance(self._name, image, self._values.rec709_from_light, time_s, is_still)
            return frame._replace(luminance_scale=self._values.luminance_scale, saturated=self._saturated, clipped=clipped)

        if clipped:
            notice(f"{self._name}: light is clipped in the shortest exposure, too: the map holds less than there was; add a shorter one")
        return self._maker.with_estimate(self._name, made), exposure

    def _with_bright_lights(self, gain: float) -> np.ndarray:
        """The merged image with so many times the light in addition that is clipped in the shortest exposure."""
        image = self._image.copy()
        top = float(self._values.light[self._values.saturated_from]) / self._exposures[-1]
        clipped = [clipped_part(light, top, ceiling(self._values, self._exposures), gain) for light in self._lights]
        add_lights(clipped, len(self._exposures), image.reshape(*image.shape[:2], -1), self._step)
        return image

    def _take(self, codes: np.ndarray, exposure: int, spans: np.ndarray) -> None:
        self._stack[exposure] = codes
        self._newest[exposure] = self._stack[exposure]
        if codes.ndim == 3 or self._mosaic != "mono":
            self._clipped[exposure] = clipped_pixels(codes, self._values)
        pixels = codes.reshape(*codes.shape[:2], -1)
        if exposure == len(self._exposures) - 1:
            frames = {n: one.reshape(*one.shape[:2], -1) for n, one in self._newest.items()}
            self._lights = strong_lights(frames, self._values, self._exposures, spans, self._step)
            self._saturated = int(count_from(pixels, self._values.saturated_from, spans))
        else:
            self._lights = followed(self._lights, pixels, exposure, self._values)

    def _merge(self, spans: np.ndarray) -> None:
        present = tuple(sorted(self._newest))
        if present not in self._tables:
            self._tables[present] = self._tables_of(present)
        clipped = np.stack([self._clipped[n] for n in present]) if self._clipped else None
        newest = self._stack if len(present) == len(self._stack) else self._stack[list(present)]
        merged(newest, clipped, self._tables[present], spans, self._image)
        for light in moving(self._lights):
            self._merge_around(light, present, spans)
        add_lights(self._lights, len(self._exposures), self._image.reshape(*self._image.shape[:2], -1), self._step)

    def _merge_around(self, light: StrongLight, present: tuple[int, ...], spans: np.ndarray) -> None:
        """Merges the frames once more around a light, laid on the newest one by its motion."""
        places = [np.ix_(*window_on(light, n, self._image.shape, self._step)) for n in present]
        codes = np.stack([self._newest[n][place] for n, place in zip(present, places, strict=True)])
        clipped = np.stack([self._clipped[n][place] for n, place in zip(present, places, strict=True)]) if self._clipped else None
        window = np.zeros(codes.shape[1:], np.float32)
        height, width = codes.shape[1:3]
        merged(codes, clipped, self._tables[present], np.tile([0, width], (height, 1)), window)
        rows, columns = window_on(light, light.newest, self._image.shape, self._step)
        inside = (columns >= spans[rows, :1]) & (columns < spans[rows, 1:])
        self._image[np.ix_(rows, columns)] = np.where(inside.reshape(*inside.shape, *[1] * (window.ndim - 2)), window, 0)

    def _tables_of(self, present: tuple[int, ...]) -> np.ndarray:
        """Tables of the exposures that were seen; what the shortest alone tells is at the ceiling, and its excess is added apart."""
        exposures = [self._exposures[n] for n in present]
        tables = merge_tables(self._values, np.array(exposures))
        if present[-1] == len(self._exposures) - 1:
            highest = ceiling(self._values, self._exposures)
            above = self._values.light / exposures[-1] > highest
            tables[-1, above] = FAINT_WEIGHT * highest, FAINT_WEIGHT
        return tables
