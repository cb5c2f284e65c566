"""Folders of bracketed photographs: several exposures of one view, merged into the polar map of its radiance.

Radiance is in the response file's unit; for pictures by their transfer, 1 is what an exposure of 1 s at ISO 100 and f/1 makes white.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vemlight.capture.exposure_groups import Photograph, exposure_groups
from vemlight.capture.exposure_merge import (
    MAX_ROUNDING,
    CodeValues,
    clipped_pixels,
    count_from,
    measured_ratio,
    merge_tables,
    merged,
)
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.manifest import MANIFEST, read_manifest
from vemlight.capture.mosaic import Mosaic
from vemlight.capture.sequence import frame_files
from vemlight.capture.still_source import StillCodes, StillReader
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.light.exposure_tags import PhotographExposure, read_exposure
from vemlight.settings import Capture


class BracketSource:
    """The frames of a folder of photographs; see `vemlight.capture.source.FrameSource`."""

    def __init__(self, settings: Capture, folder: Path) -> None:
        """Raises UserError for what is no folder, a photograph without exposure, and exposures that are no brackets."""
        if not folder.is_dir():
            raise UserError(f"{folder}: is one file, and brackets are a folder of photographs; name the folder, or leave out --brackets")
        recorded = [folder / entry.name for entry in read_manifest(folder)] if (folder / MANIFEST).exists() else None
        self._paths = recorded or [file.path for file in frame_files(folder)]
        tags = [read_exposure(path) for path in self._paths]
        self._check_lenses(tags)
        self._exposures = [tag.exposure_s for tag in tags]
        names = [str(path) for path in self._paths]
        groups = exposure_groups([*map(Photograph, names, self._exposures)], str(folder))
        end = min(settings.end or len(groups), len(groups))
        if settings.start >= end:
            frames = f"frames 0 to {len(groups) - 1}, of which [capture] start and end leave none"
            raise UserError(f"{folder}: has {frames}; correct them")
        if len(groups) > 1:
            notice(f"{folder}: its {len(self._paths)} photographs are {len(groups)} frames, the first of {len(groups[0])} exposures")
        self._groups = groups[settings.start : end]
        self._merger = BracketMerger(FrameMaker(settings, folder))
        self._stills = StillReader(settings, self._merger.maker)
        self.fps = settings.fps * settings.speed

    def __len__(self) -> int:
        return len(self._groups)

    def paths(self, k: int) -> tuple[Path, ...]:
        return tuple(self._paths[n] for n in self._groups[k])

    @property
    def calibration(self) -> tuple[Path, ...]:
        return self._merger.maker.files

    def check(self) -> None:
        """Raises UserError for a first frame from which no map can be made."""
        self.frame(0)

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1. Raises UserError for a photograph that is damaged, or unlike the others of its frame."""
        group = self._groups[k]
        stills = [self._stills.codes(self._paths[n]) for n in group]
        for n, still in zip(group[1:], stills[1:], strict=True):
            self._check_alike(self._paths[group[0]], stills[0], self._paths[n], still)
        codes = np.stack([still.codes for still in stills])
        exposures = refined([self._exposures[n] for n in group], codes, stills[0].values, [self._paths[n].name for n in group])
        name = str(self._paths[group[0]])
        return self._merger.frame(name, codes, stills[0].mosaic, stills[0].values, exposures, k / self.fps)

    def _check_lenses(self, tags: Sequence[PhotographExposure]) -> None:
        with_aperture = [tag.f_number is not None for tag in tags]
        if any(with_aperture) and not all(with_aperture):
            which, other = self._paths[with_aperture.index(False)], self._paths[with_aperture.index(True)].name
            raise UserError(f"{which}: does not say its f-number, and {other} does; leave one of them out")

    @staticmethod
    def _check_alike(first_path: Path, first: StillCodes, path: Path, still: StillCodes) -> None:
        if still.codes.shape[:2] != first.codes.shape[:2]:
            sizes = [f"{one.codes.shape[1]}x{one.codes.shape[0]}" for one in (still, first)]
            raise UserError(f"{path}: is {sizes[0]} and {first_path.name} {sizes[1]}; exposures of one frame have one size")
        same = still.codes.shape == first.codes.shape and still.codes.dtype == first.codes.dtype and still.mosaic == first.mosaic
        if not (same and np.array_equal(still.values.light, first.values.light)):
            raise UserError(f"{path}: holds other codes than {first_path.name} (bits, colours or curve); leave one of them out")


class BracketMerger:
    """Makes frames of several exposures of one view."""

    def __init__(self, maker: FrameMaker) -> None:
        self.maker = maker
        self._image: np.ndarray | None = None
        self._tables: tuple[tuple[float, ...], CodeValues, np.ndarray] | None = None

    def frame(
        self, name: str, codes: np.ndarray, mosaic: Mosaic | None, values: CodeValues, exposures: Sequence[float], time_s: float
    ) -> Frame:
        """The frame of `codes` (exposures, height, width) of a mosaic, or (.., 3), from the longest to the shortest of `exposures`.

        Its `saturated` counts codes that are clipped in the shortest exposure, too. Raises UserError as `FrameMaker.frame`.
        """
        spans = self.maker.spans(name, codes.shape[1:], mosaic)
        if self._tables is None or self._tables[0] != tuple(exposures) or self._tables[1] is not values:
            self._tables = tuple(exposures), values, merge_tables(values, np.array(exposures))
        if self._image is None or self._image.shape != codes.shape[1:]:
            self._image = np.zeros(codes.shape[1:], np.float32)
        in_colour = codes.ndim == 4 or mosaic != "mono"
        clipped = np.stack([clipped_pixels(one, values) for one in codes]) if in_colour or values.reach else None
        merged(codes, clipped, self._tables[2], spans, self._image)
        saturated = int(count_from(codes[-1].reshape(*codes.shape[1:3], -1), values.saturated_from, spans))
        if saturated:
            notice(f"{name}: light is clipped in its shortest exposure, too: the map holds less than there was; add a shorter one")
        image, top = self._image, codes[-1] >= values.saturated_from

        def made(gain: float) -> Frame:
            brighter = np.where(top, np.float32(1 + gain) * image, image) if gain else image
            frame = self.maker.frame_from_radiance(name, brighter, values.rec709_from_light, time_s)
            return frame._replace(luminance_scale=values.luminance_scale, saturated=saturated, clipped=saturated > 0)

        return self.maker.with_estimate(name, made)


def refined(exposures: Sequence[float], codes: np.ndarray, values: CodeValues, names: Sequence[str]) -> list[float]:
    """Exposures, falling, whose ratios the pictures themselves correct where they are rounded; the longest is kept as told.

    codes: (exposures, ...). names: of the photographs, for the notice of a ratio that is farther off than rounding explains; it is kept.
    """
    kept = [exposures[0]]
    for k, (longer, shorter) in enumerate(itertools.pairwise(exposures)):
        told = longer / shorter
        ratio = measured_ratio(codes[k], codes[k + 1], values, told)
        if ratio is not None and abs(ratio / told - 1) > MAX_ROUNDING:
            fault = f"its light is {told / ratio:.3g} times what its exposure says beside {names[k]}"
            notice(f"{names[k + 1]}: {fault}; the exposure is believed")
            ratio = None
        kept.append(kept[-1] / (ratio or told))
    return kept
