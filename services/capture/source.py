"""Where frames come from: files replayed by index, each made into a polar map of radiance."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from services.capture.polar import LatlongToPolar, latlong_to_polar, polar_from_latlong
from services.files import BadInput
from services.images import read_radiance
from services.settings import Capture
from services.sphere import Coverage

SUFFIXES = (".exr", ".hdr", ".pic")
BUNDLED = Path(__file__).parents[2] / "replay_data" / "outdoor"


class Frame(NamedTuple):
    """One moment of the light around."""

    radiance: np.ndarray  # (rows, cols, 3) float32, polar map; nan and inf stand where the source had them
    coverage: Coverage
    time_s: float  # of the capture, from the start of the sequence
    luminance_scale: float | None  # cd/m2 per unit of luminance, where it is known
    black: int  # values that the sensor clipped at its lower end; 0 for files of radiance
    saturated: int  # and at its upper end


class LatlongSource:
    """Lat-long files in order, frame by frame."""

    def __init__(self, settings: Capture, paths: list[Path]):
        self.settings = settings
        self.paths = paths
        self.fps = settings.fps
        self._weights: LatlongToPolar | None = None

    def __len__(self) -> int:
        return len(self.paths)

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1. Raises BadInput for a file that is damaged or of another size than the first one read."""
        image, attributes = read_radiance(self.paths[k])
        height, width, _ = image.shape
        s = self.settings
        if self._weights is None:
            self._weights = latlong_to_polar(height, width, s.rows, s.cols, s.coverage)
        if (height, width) != (self._weights.height, self._weights.width):
            size = f"{self._weights.width}x{self._weights.height}"
            raise BadInput(f"{self.paths[k]}: is {width}x{height} and the frames before it {size}; a sequence has one size")
        scale = attributes.get("whiteLuminance")
        return Frame(polar_from_latlong(image, self._weights), s.coverage, k / self.fps, scale, 0, 0)


def open_source(settings: Capture) -> LatlongSource:
    """The source that the settings name. Raises BadInput when it is not there or not whole."""
    path = Path(settings.source) if settings.source else BUNDLED
    if not path.exists():
        if not settings.source:
            raise BadInput("replay_data/ is not beside the services folder; name a file or folder as [capture] source")
        raise BadInput(f"{path}: there is no such file or folder; check [capture] source")
    return LatlongSource(settings, frame_paths(path) if path.is_dir() else [path])


def frame_paths(folder: Path) -> list[Path]:
    """The images in `folder` in order. Raises BadInput when there are none, or when numbered files leave a number out."""
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not p.stem.endswith(".part"))
    if not paths:
        raise BadInput(f"{folder}: holds no {' or '.join(SUFFIXES)} files; name a folder of frames")
    numbered = [re.fullmatch(r"(.*?)(\d+)", p.stem) for p in paths]
    if len(paths) == 1 or len({match and match[1] for match in numbered}) > 1 or numbered[0] is None:
        return paths
    by_number = sorted((int(match[2]), p) for match, p in zip(numbered, paths, strict=True) if match)
    for (before, path), (after, _) in zip(by_number, by_number[1:], strict=False):
        if after != before + 1:
            digits = len(re.fullmatch(r".*?(\d+)", path.stem)[1])  # type: ignore[index]
            raise BadInput(f"{folder}: frame {before + 1:0{digits}d} is missing after {path.name}; copy it again or renumber the rest")
    return [path for _, path in by_number]
