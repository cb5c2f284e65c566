"""One image made into one frame: the polar map of its radiance, with what was clipped and where light sits inside bright cells."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from vemlight.capture.exr_header import bright_cells_from_attributes, count_from_attributes, scale_from_attributes
from vemlight.capture.fisheye import (
    ALL,
    Bayer,
    FisheyeToPolar,
    colour_lattices,
    fisheye_bright_cells,
    fisheye_to_polar,
    lit_spans,
)
from vemlight.capture.lens import Lens, direction_from_pixel, read_lens
from vemlight.capture.polar import LatlongToPolar, latlong_bright_cells, latlong_to_polar, polar_from_latlong
from vemlight.capture.response import Response, radiance_table, read_response
from vemlight.capture.scatter import Threads, clipped_counts, polar_from_codes, polar_from_fisheye
from vemlight.errors import UserError
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance
from vemlight.light.sphere import Coverage, cell_solid_angles
from vemlight.settings import Capture

Mosaic = Literal["mono"] | Bayer
MOSAICS: tuple[Mosaic, ...] = ("mono", *get_args(Bayer))
BRIGHT = 1 / 500  # of the map's power: a cell that holds more is sampled in sub-cells; a tenth of a light when there are 50
MAX_BRIGHT_CELLS = 64  # such cells a frame


class Frame(NamedTuple):
    """One moment of the light around."""

    radiance: np.ndarray  # (rows, cols, 3) float32, polar map; nan and inf stand where the source had them
    coverage: Coverage
    time_s: float  # of the capture, from the start of the sequence
    luminance_scale: float | None  # cd/m2 per unit of luminance, where it is known
    black: int  # values inside the lens's rim at the sensor's lowest code; 0 for files of radiance
    saturated: int  # and at its highest
    bright_cells: BrightCells = NO_BRIGHT_CELLS  # where light sits inside each cell with more than 1/500 of the power
    lost: int = 0  # cameras: frames that the kernel counted and we never had, since the frame before
    monotonic_ns: int | None = None  # cameras: the kernel's time stamp


class FrameMaker:
    """Makes frames of images of one kind and size; weights are made for the first image."""

    def __init__(self, settings: Capture, folder: Path):
        """lens.toml and response.toml are looked for in `folder` when the settings name none. Raises UserError for bad ones."""
        self._settings = settings
        self._lens_path = Path(settings.lens) if settings.lens else folder / "lens.toml"
        self._response_path = Path(settings.response) if settings.response else folder / "response.toml"
        self._lens: Lens | None = read_lens(self._lens_path) if settings.lens or self._lens_path.exists() else None
        self._response: Response | None = (
            read_response(self._response_path) if settings.response or self._response_path.exists() else None
        )
        self._threads = Threads(settings.threads)
        self._table: np.ndarray | None = None
        self._shape: tuple[int, int] | None = None
        self._latlong: LatlongToPolar | None = None
        self._fisheye: list[FisheyeToPolar] = []
        self._spans = np.empty((0, 2), np.int64)

    @property
    def lens(self) -> Lens | None:
        """The lens, if there is one."""
        return self._lens

    @property
    def files(self) -> tuple[Path, ...]:
        """The lens and response files that are in use."""
        return tuple(
            path for path, used in ((self._lens_path, self._lens), (self._response_path, self._response)) if used is not None
        )

    def frame(self, name: str, image: np.ndarray, attributes: dict[str, Any], time_s: float) -> Frame:
        """The frame of a file's `image` (height, width, 3) float32 with the file's `attributes`; `name` is for errors."""
        kind = attributes.get("vemlight:kind")
        if kind is None:
            kind = "latlong" if self._lens is None else "fisheye" if self._response is None else "codes"
        self._check_size(name, image)
        s = self._settings
        if kind == "codes":
            mosaic = attributes.get("vemlight:mosaic")
            if mosaic not in (None, *MOSAICS):
                raise UserError(f"{name}: vemlight:mosaic = {str(mosaic)[:40]!r} is not known; it is one of {', '.join(MOSAICS)}")
            return self.frame_from_codes(name, _whole_codes(name, image, mosaic), mosaic, time_s)
        if kind == "polar":
            if (*image.shape[:2], attributes.get("vemlight:coverage")) != (s.rows, s.cols, s.coverage):
                found = f"{attributes.get('vemlight:coverage')} of {image.shape[0]} x {image.shape[1]}"
                raise UserError(f"{name}: is a {found} cells and [capture] asks for a {s.coverage} of {s.rows} x {s.cols}; set it so")
            radiance, bright = image, bright_cells_from_attributes(name, attributes, s.rows * s.cols)
        elif kind == "latlong":
            height, width = image.shape[:2]
            weights = self._latlong = self._latlong or latlong_to_polar(height, width, s.rows, s.cols, s.coverage)
            radiance = polar_from_latlong(image, weights)
            bright = latlong_bright_cells(image, weights, brightest_cells(radiance, s.coverage), s.coverage)
        elif kind == "fisheye":
            self._prepare(name, image, None)
            radiance = polar_from_fisheye(image, self._fisheye[0], self._threads)
            flat = image.reshape(-1, 3)
            bright = self._bright_cells(radiance, lambda pixel: luminance_from_rgb(flat[pixel]))
        else:
            raise UserError(f"{name}: vemlight:kind = {str(kind)[:40]!r} is not known; it is latlong, fisheye, codes or polar")
        black, saturated = (count_from_attributes(attributes, key) for key in ("vemlight:black", "vemlight:saturated"))
        return Frame(radiance, s.coverage, time_s, scale_from_attributes(attributes), black, saturated, bright)

    def frame_from_codes(self, name: str, codes: np.ndarray, mosaic: Mosaic | None, time_s: float) -> Frame:
        """The frame of raw `codes` uint8 or uint16: (height, width) of a `mosaic`, or (height, width, 3) without one.

        Raises UserError without lens or response, and for codes above those of the response.
        """
        self._check_size(name, codes)
        self._prepare(name, codes, mosaic)
        response = self._response
        if response is None:
            raise UserError(f"{name}: holds raw codes and {self._response_path} is not there; name their [capture] response")
        if self._table is None:
            known = radiance_table(response)
            self._table = np.concatenate([known, np.full(65536 - len(known), known[-1], np.float32)])
        s, table = self._settings, self._table
        channels = [codes] * 3 if codes.ndim == 2 else [np.ascontiguousarray(codes[..., n]) for n in range(3)]
        distinct = channels[:1] if codes.ndim == 2 else channels
        counts = [clipped_counts(channel, self._spans, response.top) for channel in distinct]
        if (highest := max(count[2] for count in counts)) > response.top:
            raise UserError(f"{name}: has code {highest} and the response {response.bits} bits; give the response of this sensor")
        if mosaic == "mono":
            radiance = np.repeat(polar_from_codes(codes, self._fisheye[0], table, self._threads)[..., None], 3, axis=-1)
        else:
            weights = self._fisheye if len(self._fisheye) == 3 else self._fisheye * 3
            maps = [polar_from_codes(channel, w, table, self._threads) for channel, w in zip(channels, weights, strict=True)]
            radiance = np.stack(maps, axis=-1)
        flat = codes.reshape(-1) if codes.ndim == 2 else codes.reshape(-1, 3)
        # a mosaic's green pixels stand for its luminance
        mono = codes.ndim == 2
        bright = self._bright_cells(radiance, lambda pixel: table[flat[pixel]] if mono else luminance_from_rgb(table[flat[pixel]]))
        black, saturated = (int(sum(count[n] for count in counts)) for n in (0, 1))
        return Frame(radiance, s.coverage, time_s, response.luminance_scale, black, saturated, bright)

    def _check_size(self, name: str, image: np.ndarray) -> None:
        height, width = image.shape[:2]
        if self._shape is None:
            self._shape = height, width
        if self._shape != (height, width):
            size = f"{self._shape[1]}x{self._shape[0]}"
            raise UserError(f"{name}: is {width}x{height} and the frames before it {size}; a sequence has one size")

    def _prepare(self, name: str, image: np.ndarray, mosaic: Mosaic | None) -> None:
        # weights for images like this one
        if self._fisheye:
            return
        height, width = image.shape[:2]
        if self._lens is None:
            raise UserError(f"{name}: is a fisheye frame and {self._lens_path} is not there; name its [capture] lens")
        if self._lens.size != (width, height):
            size = f"{self._lens.size[0]}x{self._lens.size[1]}"
            raise UserError(f"{name}: is {width}x{height} and the lens file is for {size}; give the lens file of this camera")
        lattices = [ALL] if mosaic in (None, "mono") else colour_lattices(mosaic)
        s, flat = self._settings, self._flat_field()
        self._fisheye = [fisheye_to_polar(self._lens, s.rows, s.cols, s.coverage, lattice, flat) for lattice in lattices]
        direction_from_pixel(np.zeros((1, 2)), self._lens)  # compiled here, and not when the first bright cell comes
        spans = np.array([lit_spans(weights) for weights in self._fisheye])
        self._spans = np.column_stack([spans[..., 0].min(0), spans[..., 1].max(0)])

    def _flat_field(self) -> np.ndarray | None:
        # the even light's image over its middle, (height, width); None without one
        lens = self._lens
        if lens is None or not lens.flat_field:
            return None
        path = self._lens_path.parent / lens.flat_field
        image = read_radiance(path)[0].mean(axis=-1)
        if image.shape != (lens.size[1], lens.size[0]):
            raise UserError(f"{path}: is {image.shape[1]}x{image.shape[0]} and the lens file is for {lens.size[0]}x{lens.size[1]}")
        y, x = np.ogrid[: image.shape[0], : image.shape[1]]
        middle = image[np.hypot(x - lens.c[0], y - lens.c[1]) < max(2, min(lens.size) / 20)].mean()
        if not (np.all(np.isfinite(image)) and middle > 0):
            raise UserError(f"{path}: is no image of even light; it must be finite, and lit where the optical axis is")
        return np.maximum(image / middle, 1e-3)  # what the lens shades to less says nothing, and lies beyond the rim

    def _bright_cells(self, radiance: np.ndarray, brightness: Callable[[np.ndarray], np.ndarray]) -> BrightCells:
        lens, weights, coverage = self._lens, self._fisheye[1 if len(self._fisheye) == 3 else 0], self._settings.coverage
        assert lens is not None
        return fisheye_bright_cells(brightness, weights, lens, brightest_cells(radiance, coverage), coverage)


def brightest_cells(radiance: np.ndarray, coverage: Coverage) -> np.ndarray:
    """Flat indices (n,) int32 of the cells of a polar map that hold more than 1/500 of its power, brightest first, 64 at most."""
    rows, cols, _ = radiance.shape
    flux = (luminance_from_rgb(radiance) * cell_solid_angles(rows, cols, coverage)[:, None].astype(np.float32)).ravel()
    flux[~(flux > 0) | ~np.isfinite(flux)] = 0
    bright = np.flatnonzero(flux > BRIGHT * flux.sum(dtype=np.float64))
    return bright[np.argsort(-flux[bright], kind="stable")][:MAX_BRIGHT_CELLS].astype(np.int32)


def _whole_codes(name: str, image: np.ndarray, mosaic: Mosaic | None) -> np.ndarray:
    # a file's float pixels as uint16 codes: (height, width) of a mosaic, else (height, width, 3)
    if mosaic:
        image = np.ascontiguousarray(image[..., 0])
    codes = np.where((image >= 0) & (image <= 65535), image, 0).astype(np.uint16)
    if not np.array_equal(codes, image):
        raise UserError(f"{name}: holds values that are no whole codes; leave the response out if it is radiance")
    return codes
