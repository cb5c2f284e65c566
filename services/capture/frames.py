"""One image made into one frame: the polar map of its radiance, the counts of clipped codes, and the samples of bright cells.

The kind of an image is in its EXR header as `vemlight:kind` (latlong, fisheye, codes or polar). Without it, a lens file makes it fisheye
and a response file raw codes.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from vemlight.capture.exr_header import bright_cells_from_attributes, count_from_attributes, scale_from_attributes
from vemlight.capture.fisheye import (
    ALL_PIXELS,
    BayerPattern,
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
from vemlight.files import contained_path
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance
from vemlight.light.sphere import Coverage, cell_solid_angles
from vemlight.settings import Capture

Mosaic = Literal["mono"] | BayerPattern  # colour filters before a sensor's pixels; "mono": none
MOSAICS: tuple[Mosaic, ...] = ("mono", *get_args(BayerPattern))
BRIGHT_FRACTION = 1 / 500  # of the map's power: a cell above it is split into sub-cell samples; a tenth of a light when there are 50
MAX_BRIGHT_CELLS = 64  # of a frame: 9 samples each stay far below the 4096 that a message takes
FLAT_FIELD_CENTRE = 1 / 20  # of the image's shorter side: radius of the disc whose mean is the axis's response; 1/40 to 1/10 do
MIN_FLAT_FIELD = 1e-3  # of the axis's response: less is noise beyond the rim, and would be divided by; any value up to 0.02 does
MAX_LATLONG_EXCESS = 2  # pixels by which a width may differ from twice the height: what rounding by other programs leaves
ALL_CODES = 2**16  # a table for uint16 codes needs no check of its index


class Frame(NamedTuple):
    """One moment of the surrounding light."""

    radiance: np.ndarray  # (rows, cols, 3) float32, polar map; nan and inf remain where the source had them
    coverage: Coverage
    time_s: float  # of the capture, from the start of the sequence
    luminance_scale: float | None  # cd/m2 per unit of luminance, where known
    black: int  # values inside the lens's rim at the sensor's lowest code; 0 for files of radiance
    saturated: int  # values at its highest code
    bright_cells: BrightCells = NO_BRIGHT_CELLS  # where light lies inside each cell with more than BRIGHT_FRACTION of the power
    lost: int = 0  # cameras: frames since the previous one that the kernel counted and we never received
    monotonic_ns: int | None = None  # cameras: the kernel's time stamp


class FrameMaker:
    """Makes frames from images of one kind and size; the weights are computed for the first image."""

    def __init__(self, settings: Capture, folder: Path):
        """Looks for lens.toml and response.toml in `folder` when the settings name none. Raises UserError for invalid ones."""
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
        """The lens and response files in use."""
        return tuple(
            path for path, used in ((self._lens_path, self._lens), (self._response_path, self._response)) if used is not None
        )

    def frame(self, name: str, image: np.ndarray, attributes: dict[str, Any], time_s: float) -> Frame:
        """The frame of a file's `image` (height, width, 3) float32 with the file's `attributes`; `name` is for errors.

        Raises UserError for an image of another kind, size or map than expected.
        """
        kind = self._kind(attributes)
        self._check_size(name, image)
        if kind == "codes":
            mosaic = attributes.get("vemlight:mosaic")
            if mosaic not in (None, *MOSAICS):
                raise UserError(f"{name}: vemlight:mosaic = {str(mosaic)[:40]!r} is not known; it is one of {', '.join(MOSAICS)}")
            return self.frame_from_codes(name, _whole_codes(name, image, mosaic), mosaic, time_s)
        if kind == "polar":
            radiance, bright_cells = self._from_polar(name, image, attributes)
        elif kind == "latlong":
            radiance, bright_cells = self._from_latlong(name, image)
        elif kind == "fisheye":
            radiance, bright_cells = self._from_fisheye(name, image)
        else:
            raise _unknown_kind(name, kind)
        black, saturated = (count_from_attributes(attributes, key) for key in ("vemlight:black", "vemlight:saturated"))
        scale = scale_from_attributes(attributes)
        return Frame(radiance, self._settings.coverage, time_s, scale, black, saturated, bright_cells)

    def frame_from_codes(self, name: str, codes: np.ndarray, mosaic: Mosaic | None, time_s: float) -> Frame:
        """The frame of raw `codes` uint8 or uint16: (height, width) of a `mosaic`, or (height, width, 3) without one.

        Raises UserError without lens or response, and for codes above those of the response.
        """
        self._check_size(name, codes)
        self._prepare(name, codes, mosaic)
        response, table = self._calibrated(name)
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
        # a mosaic's green pixels represent its luminance
        in_colour = codes.ndim == 3
        bright = self._bright_cells(radiance, lambda pixel: luminance_from_rgb(table[flat[pixel]]) if in_colour else table[flat[pixel]])
        black, saturated = (int(sum(count[n] for count in counts)) for n in (0, 1))
        return Frame(radiance, self._settings.coverage, time_s, response.luminance_scale, black, saturated, bright)

    def check(self, name: str, shape: tuple[int, ...], attributes: dict[str, Any]) -> None:
        """Raises UserError for an image of a kind and size that `frame` refuses, without making its map."""
        match kind := self._kind(attributes):
            case "codes":
                self.check_codes(name, shape)
            case "polar":
                self._check_polar(name, shape, attributes)
            case "latlong":
                self._check_latlong(name, shape)
            case "fisheye":
                self._check_lens(name, shape)
            case _:
                raise _unknown_kind(name, kind)

    def check_codes(self, name: str, shape: tuple[int, ...]) -> None:
        """Raises UserError for raw codes without lens or response, or of another size than the lens."""
        self._check_lens(name, shape)
        self._check_response(name)

    def _kind(self, attributes: dict[str, Any]) -> Any:
        unsaid = "latlong" if self._lens is None else "fisheye" if self._response is None else "codes"
        return attributes.get("vemlight:kind", unsaid)

    def _check_polar(self, name: str, shape: tuple[int, ...], attributes: dict[str, Any]) -> None:
        s, coverage = self._settings, attributes.get("vemlight:coverage")
        if (*shape[:2], coverage) != (s.rows, s.cols, s.coverage):
            wanted = f"a {s.coverage} of {s.rows} x {s.cols} is asked for"
            mend = "ask for its own: --coverage, or [capture] rows, cols and coverage"
            raise UserError(f"{name}: is a {coverage} of {shape[0]} x {shape[1]} cells and {wanted}; {mend}")

    def _from_polar(self, name: str, image: np.ndarray, attributes: dict[str, Any]) -> tuple[np.ndarray, BrightCells]:
        self._check_polar(name, image.shape, attributes)
        s = self._settings
        return image, bright_cells_from_attributes(name, attributes, s.rows * s.cols)

    @staticmethod
    def _check_latlong(name: str, shape: tuple[int, ...]) -> None:
        height, width = shape[:2]
        if abs(width - 2 * height) > MAX_LATLONG_EXCESS:
            fisheye = "a fisheye frame needs lens.toml beside it, or its lens by --lens or [capture] lens"
            raise UserError(f"{name}: is {width}x{height} and a lat-long map of the whole sphere is twice as wide as high; {fisheye}")

    def _from_latlong(self, name: str, image: np.ndarray) -> tuple[np.ndarray, BrightCells]:
        s = self._settings
        height, width, _ = image.shape
        self._check_latlong(name, image.shape)
        weights = self._latlong = self._latlong or latlong_to_polar(height, width, s.rows, s.cols, s.coverage)
        radiance = polar_from_latlong(image, weights)
        return radiance, latlong_bright_cells(image, weights, brightest_cells(radiance, s.coverage), s.coverage)

    def _from_fisheye(self, name: str, image: np.ndarray) -> tuple[np.ndarray, BrightCells]:
        self._prepare(name, image, None)
        radiance, flat = polar_from_fisheye(image, self._fisheye[0], self._threads), image.reshape(-1, 3)
        return radiance, self._bright_cells(radiance, lambda pixel: luminance_from_rgb(flat[pixel]))

    def _check_response(self, name: str) -> Response:
        if self._response is None:
            where = "name it by --response or [capture] response"
            raise UserError(f"{name}: holds raw codes, which need a response file, and {self._response_path} is not there; {where}")
        return self._response

    def _calibrated(self, name: str) -> tuple[Response, np.ndarray]:
        # the response, and its radiance of each of ALL_CODES; those above its range repeat the highest
        response = self._check_response(name)
        if self._table is None:
            known = radiance_table(response)
            self._table = np.concatenate([known, np.full(ALL_CODES - len(known), known[-1], np.float32)])
        return response, self._table

    def _check_size(self, name: str, image: np.ndarray) -> None:
        height, width = image.shape[:2]
        if self._shape is None:
            self._shape = height, width
        if self._shape != (height, width):
            size = f"{self._shape[1]}x{self._shape[0]}"
            raise UserError(f"{name}: is {width}x{height} and the frames before it {size}; a sequence has one size")

    def _check_lens(self, name: str, shape: tuple[int, ...]) -> Lens:
        height, width = shape[:2]
        if self._lens is None:
            where = "name it by --lens or [capture] lens"
            raise UserError(f"{name}: is a fisheye frame, which needs a lens file, and {self._lens_path} is not there; {where}")
        if self._lens.size != (width, height):
            size = f"{self._lens.size[0]}x{self._lens.size[1]}"
            raise UserError(f"{name}: is {width}x{height} and the lens file is for {size}; give the lens file of this camera")
        return self._lens

    def _prepare(self, name: str, image: np.ndarray, mosaic: Mosaic | None) -> None:
        # computes the weights for images like this one
        if self._fisheye:
            return
        lens = self._check_lens(name, image.shape)
        lattices = [ALL_PIXELS] if mosaic in (None, "mono") else colour_lattices(mosaic)
        s, flat_field = self._settings, _flat_field(lens, self._lens_path)
        self._fisheye = [fisheye_to_polar(lens, s.rows, s.cols, s.coverage, lattice, flat_field) for lattice in lattices]
        direction_from_pixel(np.zeros((1, 2)), lens)  # compiles it now, and not when the first bright cell appears
        spans = np.array([lit_spans(weights) for weights in self._fisheye])
        self._spans = np.column_stack([spans[..., 0].min(0), spans[..., 1].max(0)])

    def _bright_cells(self, radiance: np.ndarray, brightness: Callable[[np.ndarray], np.ndarray]) -> BrightCells:
        lens, weights, coverage = self._lens, self._fisheye[1 if len(self._fisheye) == 3 else 0], self._settings.coverage
        assert lens is not None
        return fisheye_bright_cells(brightness, weights, lens, brightest_cells(radiance, coverage), coverage)


def brightest_cells(radiance: np.ndarray, coverage: Coverage) -> np.ndarray:
    """Cells of a polar map with more than BRIGHT_FRACTION of its power, brightest first, at most MAX_BRIGHT_CELLS.

    Returns flat indices (n,) int32. Cells that are not finite or negative count as dark.
    """
    rows, cols, _ = radiance.shape
    flux = (luminance_from_rgb(radiance) * cell_solid_angles(rows, cols, coverage)[:, None].astype(np.float32)).ravel()
    flux[~(flux > 0) | ~np.isfinite(flux)] = 0
    bright = np.flatnonzero(flux > BRIGHT_FRACTION * flux.sum(dtype=np.float64))
    return bright[np.argsort(-flux[bright], kind="stable")][:MAX_BRIGHT_CELLS].astype(np.int32)


def _flat_field(lens: Lens, lens_path: Path) -> np.ndarray | None:
    # the image of an evenly lit surface over its value at the axis, (height, width); None where the lens has none
    if not lens.flat_field:
        return None
    path = contained_path(lens_path.parent, lens.flat_field, f"{lens_path}: flat_field")
    image = read_radiance(path)[0].mean(axis=-1)
    if image.shape != (lens.size[1], lens.size[0]):
        sizes = f"is {image.shape[1]}x{image.shape[0]} and the lens file is for {lens.size[0]}x{lens.size[1]}"
        raise UserError(f"{path}: {sizes}; name the flat field of this lens")
    y, x = np.ogrid[: image.shape[0], : image.shape[1]]
    centre = image[np.hypot(x - lens.c[0], y - lens.c[1]) < max(2, min(lens.size) * FLAT_FIELD_CENTRE)].mean()
    if not (np.all(np.isfinite(image)) and centre > 0):
        raise UserError(f"{path}: is no image of an evenly lit surface; it must be finite, and lit at the optical axis")
    return np.maximum(image / centre, MIN_FLAT_FIELD)


def _whole_codes(name: str, image: np.ndarray, mosaic: Mosaic | None) -> np.ndarray:
    # a file's float pixels as uint16 codes: (height, width) of a mosaic, else (height, width, 3)
    if mosaic:
        image = np.ascontiguousarray(image[..., 0])
    codes = np.where((image >= 0) & (image < ALL_CODES), image, 0).astype(np.uint16)
    if not np.array_equal(codes, image):
        raise UserError(f"{name}: holds values that are no whole codes; leave the response out if it is radiance")
    return codes


def _unknown_kind(name: str, kind: Any) -> UserError:
    return UserError(f"{name}: vemlight:kind = {str(kind)[:40]!r} is not known; it is latlong, fisheye, codes or polar")
