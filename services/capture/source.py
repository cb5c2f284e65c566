"""Where frames come from: files replayed by index, each made into a polar map of radiance.

Frames are lat-long images, fisheye images of radiance (with a lens file) or of raw codes (with a response file too). What a frame is
stands in its EXR header as `vemlight:kind`; without it, a lens file makes it fisheye and a response file raw. lens.toml and
response.toml are looked for beside the frames when the settings name none. A frame's nan, inf and negative values stay in the
cells that they touch.
"""

from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import msgspec
import numpy as np

from services.capture.fisheye import FisheyeToPolar, fisheye_to_polar, polar_from_fisheye
from services.capture.lens import Lens, read_lens
from services.capture.polar import LatlongToPolar, latlong_to_polar, polar_from_latlong
from services.capture.response import Response, clipped_counts, radiance_from_code, read_response
from services.capture.sequence import MANIFEST, Entry, check_digest, frame_paths, read_manifest
from services.files import BadInput
from services.images import read_radiance, write_exr
from services.settings import Capture
from services.sphere import Coverage

BUNDLED = Path(__file__).parents[2] / "replay_data" / "outdoor"


class Frame(NamedTuple):
    """One moment of the light around."""

    radiance: np.ndarray  # (rows, cols, 3) float32, polar map; nan and inf stand where the source had them
    coverage: Coverage
    time_s: float  # of the capture, from the start of the sequence
    luminance_scale: float | None  # cd/m2 per unit of luminance, where it is known
    black: int  # values inside the lens's rim at the sensor's lowest code; 0 for files of radiance
    saturated: int  # and at its highest


class Source(Protocol):
    """Frames by index."""

    fps: float

    def __len__(self) -> int: ...

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1, the same bits each time. Raises BadInput for what the user must mend."""
        ...


class PolarMaker:
    """Makes polar maps of images of one kind and size; the weights are made for the first image."""

    def __init__(self, settings: Capture, folder: Path):
        self.settings = settings
        self._lens_path = Path(settings.lens) if settings.lens else folder / "lens.toml"
        self._response_path = Path(settings.response) if settings.response else folder / "response.toml"
        self._lens: Lens | None = read_lens(self._lens_path) if settings.lens or self._lens_path.exists() else None
        self._response: Response | None = (
            read_response(self._response_path) if settings.response or self._response_path.exists() else None
        )
        self._latlong: LatlongToPolar | None = None
        self._fisheye: FisheyeToPolar | None = None
        self._shape: tuple[int, int] | None = None

    def frame(self, path: Path, image: np.ndarray, attributes: dict[str, Any], time_s: float) -> Frame:
        """The polar map of `image` (height, width, 3) float32 with the `attributes` of its file at `path`, named in errors."""
        height, width = image.shape[:2]
        if self._shape is None:
            self._shape = height, width
        if self._shape != (height, width):
            size = f"{self._shape[1]}x{self._shape[0]}"
            raise BadInput(f"{path}: is {width}x{height} and the frames before it {size}; a sequence has one size")
        kind = attributes.get("vemlight:kind")
        if kind is None:
            kind = "latlong" if self._lens is None else "fisheye" if self._response is None else "codes"
        scale = attributes.get("whiteLuminance")
        s, black, saturated = self.settings, 0, 0
        if kind == "latlong":
            self._latlong = self._latlong or latlong_to_polar(height, width, s.rows, s.cols, s.coverage)
            radiance = polar_from_latlong(image, self._latlong)
        elif kind in ("fisheye", "codes"):
            weights = self._weights(path, height, width)
            if kind == "codes":
                image, black, saturated, scale = self._decoded(path, image, weights)
            radiance = polar_from_fisheye(image, weights)
        elif kind == "polar":
            if (height, width, attributes.get("vemlight:coverage")) != (s.rows, s.cols, s.coverage):
                found = f"{attributes.get('vemlight:coverage')} of {height} x {width}"
                raise BadInput(f"{path}: is a {found} cells and [capture] asks for a {s.coverage} of {s.rows} x {s.cols}; set it so")
            radiance = image
        else:
            raise BadInput(f"{path}: vemlight:kind = {str(kind)[:40]!r} is not known; it is latlong, fisheye, codes or polar")
        return Frame(radiance, s.coverage, time_s, scale, black, saturated)

    def _weights(self, path: Path, height: int, width: int) -> FisheyeToPolar:
        if self._fisheye is None:
            if self._lens is None:
                raise BadInput(f"{path}: is a fisheye frame and {self._lens_path} is not there; name its [capture] lens")
            if self._lens.size != (width, height):
                size = f"{self._lens.size[0]}x{self._lens.size[1]}"
                raise BadInput(f"{path}: is {width}x{height} and the lens file is for {size}; give the lens file of this camera")
            self._fisheye = fisheye_to_polar(self._lens, self.settings.rows, self.settings.cols, self.settings.coverage)
        return self._fisheye

    def _decoded(self, path: Path, image: np.ndarray, weights: FisheyeToPolar) -> tuple[np.ndarray, int, int, float | None]:
        if self._response is None:
            raise BadInput(f"{path}: holds raw codes and {self._response_path} is not there; name their [capture] response")
        if not np.all(np.isfinite(image) & (image == np.rint(image))):
            raise BadInput(f"{path}: holds values that are no whole codes; leave the response out if it is radiance")
        code = image.astype(np.int64)
        try:
            radiance = radiance_from_code(code, self._response)
        except BadInput as error:
            raise BadInput(f"{path}: {error}") from error
        black, saturated = clipped_counts(code.reshape(-1, 3)[weights.pixel], self._response)
        return radiance, black, saturated, self._response.luminance_scale


class Files:
    """Image files in order, frame by frame."""

    def __init__(self, settings: Capture, paths: list[Path], entries: list[Entry] | None):
        self.paths = paths
        self.entries = entries
        self._maker = PolarMaker(settings, paths[0].parent)
        self._checked: set[int] = set()
        rate = read_radiance(paths[0])[1].get("framesPerSecond")
        self.fps = float(Fraction(rate)) if rate else settings.fps

    def __len__(self) -> int:
        return len(self.paths)

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1. Raises BadInput for a file that is damaged, changed or of another size than the first one read."""
        path = self.paths[k]
        if self.entries and k not in self._checked:
            check_digest(path, self.entries[k].sha256)
            self._checked.add(k)
        image, attributes = read_radiance(path)
        time_s = self.entries[k].time_s if self.entries else k / self.fps
        return self._maker.frame(path, image, attributes, time_s)


def polar_file(frame: Path, lens: Path, response: Path | None, out: Path, settings: Capture | None = None) -> None:
    """Writes the polar map of one fisheye frame to the EXR `out`, in the size and coverage of the settings (90 x 360 hemisphere).

    Raises BadInput for a file that cannot be used, OSError when the disk refuses.
    """
    settings = msgspec.structs.replace(
        settings or Capture(), source=str(frame), lens=str(lens), response=str(response) if response else ""
    )
    made = Files(settings, [frame], None).frame(0)
    attributes: dict[str, Any] = {"vemlight:kind": "polar", "vemlight:coverage": made.coverage}
    if made.luminance_scale is not None:
        attributes["whiteLuminance"] = made.luminance_scale
    write_exr(out, made.radiance, attributes)


def open_source(settings: Capture) -> Source:
    """The source that the settings name. Raises BadInput when it is not there or not whole."""
    path = Path(settings.source) if settings.source else BUNDLED
    if not path.exists():
        if not settings.source:
            raise BadInput("replay_data/ is not beside the services folder; name a file or folder as [capture] source")
        raise BadInput(f"{path}: there is no such file or folder; check [capture] source")
    if not path.is_dir():
        return Files(settings, [path], None)
    if (path / MANIFEST).exists():
        entries = read_manifest(path)
        return Files(settings, [path / entry.name for entry in entries], entries)
    return Files(settings, frame_paths(path), None)
