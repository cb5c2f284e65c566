"""One image made into one frame: the polar map of its radiance, the counts of clipped codes, and the samples of bright cells.

The kind of an image is in its EXR header as `vemlight:kind` (latlong, fisheye, cube3x2, codes or polar). Without it the settings'
projection says it; without that, a lens file makes it fisheye and a response file raw codes.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.capture.clipped_light import gain_by_meter, level_lux, with_bright_top
from vemlight.capture.colour_coding import ColourCoding, with_bright_white
from vemlight.capture.cube import cube_directions, cube_to_polar, is_cube
from vemlight.capture.exr_header import (
    bright_cells_from_attributes,
    count_from_attributes,
    estimate_from_attributes,
    scale_from_attributes,
)
from vemlight.capture.fisheye import ALL_PIXELS, FisheyeToPolar, colour_lattices, fisheye_bright_cells, lit_runs, lit_spans
from vemlight.capture.flat_field import flat_field
from vemlight.capture.ground import with_ground
from vemlight.capture.lens import Lens, read_lens
from vemlight.capture.mosaic import ALL_CODES, Mosaic, mosaic_from_attributes, whole_codes
from vemlight.capture.mosaic_lights import is_sharper_than_mosaic
from vemlight.capture.planes import Planes, linear_from_planes
from vemlight.capture.polar import WHOLE_SPHERE, LatlongToPolar, latlong_bright_cells, latlong_to_polar, polar_from_latlong, used_rows
from vemlight.capture.response import Response, radiance_table, read_response
from vemlight.capture.scatter import Threads, clipped_counts, polar_from_codes, polar_from_fisheye, polar_from_gray
from vemlight.capture.several_lenses import check_lenses, directions_of, lenses_to_polar
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.mask import Mask
from vemlight.light.sphere import Coverage, cell_solid_angles
from vemlight.settings import Capture

BRIGHT_FRACTION = 1 / 500  # of the map's power: a cell above it is split into sub-cell samples; a tenth of a light when there are 50
MAX_BRIGHT_CELLS = 64  # of a frame: 9 samples each stay far below the 4096 that a message takes
MAX_LATLONG_EXCESS = 2  # pixels by which a width may differ from twice the height: what rounding by other programs leaves


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
    masks: tuple[Mask, ...] = ()  # that were taken out of the radiance
    masked_cells: int = 0  # that they cover, wholly or in part
    clipped: bool = False  # cameras, codes: light is clipped, in the shortest exposure too, and the map holds less than there was
    estimated_lux: float = 0.0  # on a level surface, of clipped light: estimated by a light meter, and added to what was seen


class FrameMaker:
    """Makes frames from images of one kind and size; the weights are computed for the first image."""

    def __init__(self, settings: Capture, folder: Path):
        """Looks for lens.toml and response.toml in `folder` when the settings name none. Raises UserError for invalid ones."""
        self._settings = settings
        beside = folder / "lens.toml"
        flat = settings.projection in ("equirect", "cube3x2")
        self._lens_paths = tuple(map(Path, settings.lenses)) or (() if flat or not beside.exists() else (beside,))
        self._lens_path = beside
        self._response_path = Path(settings.response) if settings.response else folder / "response.toml"
        self._lenses: tuple[Lens, ...] = tuple(map(read_lens, self._lens_paths))
        self._check_projection()
        self._response: Response | None = read_response(self._response_path) if settings.response or self._response_path.exists() else None
        self._threads = Threads(settings.threads)
        self._table: np.ndarray | None = None
        self._shape: tuple[int, int] | None = None
        self._latlong: LatlongToPolar | None = None
        self._fisheye: list[FisheyeToPolar] = []
        self._pixels: np.ndarray | None = None
        self._directions: Callable[[np.ndarray], np.ndarray] = partial(directions_of, self._lenses)
        self._said_sharp = False
        self._spans, self._runs = np.empty((0, 2), np.int64), np.empty((0, 3), np.int64)

    def _check_projection(self) -> None:
        """Raises UserError for a fisheye without lens file, and for several lenses that are not for one frame."""
        if self._settings.projection == "fisheye" and not self._lenses:
            where = "name it by --lens or [capture] lens"
            raise UserError(f"--projection fisheye: needs a lens file, and {self._lens_path} is not there; {where}")
        sizes_of = [lens.size for lens in self._lenses]
        for path, lens in zip(self._lens_paths, self._lenses, strict=True):
            if lens.size != sizes_of[0]:
                width, height = sizes_of[0]
                first_path = next(iter(self._lens_paths))
                sizes = f"is for {lens.size[0]}x{lens.size[1]} and {first_path} for {width}x{height}"
                raise UserError(f"{path}: {sizes}; each has the size of the whole frame, and its own c in it")
        check_lenses([str(path) for path in self._lens_paths], self._lenses, self._settings.coverage)

    @property
    def lens(self) -> Lens | None:
        """The lens, or the first of several, if there is one."""
        return self._lenses[0] if self._lenses else None

    @property
    def response(self) -> Response | None:
        """The sensor's response, if there is one."""
        return self._response

    @property
    def files(self) -> tuple[Path, ...]:
        """The lens and response files in use."""
        return (*self._lens_paths, *((self._response_path,) if self._response else ()))

    def frame(self, name: str, image: np.ndarray, attributes: dict[str, Any], time_s: float) -> Frame:
        """The frame of a file's `image` (height, width, 3) float32 with the file's `attributes`; `name` is for errors.

        Raises UserError for an image of another kind, size or map than expected.
        """
        kind = self._kind(attributes)
        self._check_shape(name, image.shape)
        if self._settings.meter_lux and kind != "codes":
            raise UserError(f"{name}: holds radiance, of which meter_lux cannot tell what was clipped; leave meter_lux out")
        if kind == "codes":
            mosaic = mosaic_from_attributes(name, attributes)
            return self.frame_from_codes(name, whole_codes(name, image, mosaic), mosaic, time_s)
        if kind == "polar":
            radiance, bright_cells = self._from_polar(name, image, attributes)
        elif kind == "latlong":
            radiance, bright_cells = self._from_latlong(name, image)
        elif kind in ("fisheye", "cube3x2"):
            self._prepare(name, image.shape, None, kind)
            radiance, bright_cells = self._from_pixels(image)
        else:
            raise _unknown_kind(name, kind)
        black, saturated = (count_from_attributes(attributes, key) for key in ("vemlight:black", "vemlight:saturated"))
        scale = scale_from_attributes(attributes)
        made = self._made(radiance, bright_cells, time_s, scale, black, saturated)
        clipped = count_from_attributes(attributes, "vemlight:clipped") > 0
        return made._replace(clipped=clipped, estimated_lux=estimate_from_attributes(attributes))

    def frame_from_planes(self, name: str, planes: Planes, coding: ColourCoding, time_s: float) -> Frame:
        """The frame of a film's or a camera's picture in colour: its planes, and how their codes become light.

        Colours outside Rec. 709 count as 0 where a cell's mean has a component below 0. Raises UserError as `frame`.
        """
        return self.with_estimate(
            name, lambda gain: self._from_planes(name, planes, with_bright_white(coding, planes.layout.bits, gain), time_s)
        )

    def _from_planes(self, name: str, planes: Planes, coding: ColourCoding, time_s: float) -> Frame:
        kind, spans = self._kind({}), self.spans(name, (planes.height, planes.width), None)
        picture = linear_from_planes(planes, coding, spans, self._threads, self._pixels)
        self._pixels = picture.pixels  # memory that is new takes a fifth of the time
        if kind == "latlong":
            radiance, bright_cells = self._from_latlong(name, picture.pixels)
        else:
            radiance, bright_cells = self._from_pixels(picture.pixels)
        radiance = np.maximum(radiance, 0)
        return self._made(radiance, bright_cells, time_s, coding.luminance_scale, 0, picture.saturated)

    def spans(self, name: str, shape: tuple[int, ...], mosaic: Mosaic | None) -> np.ndarray:
        """The pixels of images like this one that see part of the map: (height, 2), first column of each row and one past the last.

        Raises UserError as `frame`.
        """
        self._check_shape(name, shape)
        kind = self._kind({})
        if kind != "latlong":
            self._prepare(name, shape, mosaic, "fisheye" if kind == "codes" else kind)
            return self._spans
        if mosaic not in (None, "mono"):
            raise UserError(f"{name}: is a mosaic of colours, which is read through a lens; name the lens file by --lens")
        spans = np.zeros((shape[0], 2), np.int64)
        spans[: used_rows(self._latlong_weights(name, shape)), 1] = shape[1]
        return spans

    def frame_from_radiance(
        self, name: str, image: np.ndarray, rec709_from_light: np.ndarray, time_s: float, is_still: bool = True
    ) -> Frame:
        """The frame of linear light merged from several exposures, (height, width, 3) float32, or (height, width) of the mosaic of `spans`.

        Nothing below 0 is left. is_still: no light of it was moved between its pixels. Raises UserError as `frame`.
        """
        latlong, matrix = self._kind({}) == "latlong", rec709_from_light.astype(np.float32)
        if latlong or image.ndim == 3:
            pixels = np.repeat(image[..., None], 3, axis=-1) if image.ndim == 2 else image
            if not np.array_equal(rec709_from_light, np.eye(3)):
                pixels = pixels @ matrix.T
            radiance, bright = self._from_latlong(name, pixels) if latlong else self._from_pixels(pixels)
        else:
            maps = [polar_from_gray(image, weights, self._threads) for weights in self._fisheye]
            radiance = np.stack(maps, axis=-1) @ matrix.T if len(maps) == 3 else np.repeat(maps[0][..., None], 3, axis=-1)
            flat = image.reshape(-1)
            bright = self._bright_cells(radiance, lambda pixel: flat[pixel])  # a mosaic's green pixels represent its luminance
            if is_still:
                self._say_sharp_lights(name, lambda pixel: flat[pixel], radiance)
        return self._made(np.maximum(radiance, 0), bright, time_s, None, 0, 0)

    def frame_from_codes(self, name: str, codes: np.ndarray, mosaic: Mosaic | None, time_s: float) -> Frame:
        """The frame of raw `codes` uint8 or uint16: (height, width) of a `mosaic`, or (height, width, 3) without one.

        Raises UserError without lens or response, and for codes above those of the response.
        """
        self._check_shape(name, codes.shape)
        self._prepare(name, codes.shape, mosaic)
        response, table = self._calibrated(name)
        return self.with_estimate(
            name, lambda gain: self._from_codes(name, codes, mosaic, time_s, response, with_bright_top(table, response.top, gain))
        )

    def _from_codes(
        self, name: str, codes: np.ndarray, mosaic: Mosaic | None, time_s: float, response: Response, table: np.ndarray
    ) -> Frame:
        channels = [codes] * 3 if codes.ndim == 2 else [np.ascontiguousarray(codes[..., n]) for n in range(3)]
        distinct = channels[:1] if codes.ndim == 2 else channels
        counts = [clipped_counts(channel, self._runs, response.top) for channel in distinct]
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
        if codes.ndim == 2:
            self._say_sharp_lights(name, lambda pixel: table[flat[pixel]], radiance)
        black, saturated = (int(sum(count[n] for count in counts)) for n in (0, 1))
        made = self._made(radiance, bright, time_s, response.luminance_scale, black, saturated)
        return made._replace(clipped=saturated > 0)

    def with_estimate(self, name: str, made: Callable[[float], Frame]) -> Frame:
        """`made(0)`, or what a light meter makes of it. made: the frame whose clipped pixels have so many times their light in addition.

        Raises UserError where meter_lux is set and it is no sensor's light, or its unit is not known.
        """
        frame, s = made(0.0), self._settings
        if not s.meter_lux:
            return frame
        if self._response is None or frame.luminance_scale is None:
            raise UserError(f"{name}: meter_lux needs a sensor's response file with luminance_scale; name one, or leave meter_lux out")
        if not frame.saturated:
            return frame
        seen, with_clipped_twice = (level_lux(*each[:2], each.bright_cells, frame.luminance_scale) for each in (frame, made(1.0)))
        gain = gain_by_meter(s.meter_lux, seen, with_clipped_twice - seen)
        found = made(gain)
        if s.coverage == "sphere":  # what is below the horizon stays as it was seen
            below = (np.arange(s.rows) + 1 > s.rows / 2)[:, None, None]
            found = found._replace(radiance=np.where(below, frame.radiance, found.radiance))
        return found._replace(estimated_lux=s.meter_lux - seen if gain else 0.0)

    def _made(
        self, radiance: np.ndarray, bright: BrightCells, time_s: float, luminance_scale: float | None, black: int, saturated: int
    ) -> Frame:
        if self._settings.ground:
            radiance = with_ground(radiance, bright, self._settings.ground)
        return Frame(radiance, self._settings.map_coverage, time_s, luminance_scale, black, saturated, bright)

    def _say_sharp_lights(self, name: str, brightness: Callable[[np.ndarray], np.ndarray], radiance: np.ndarray) -> None:
        # one line, once, for a bright light of a mosaic whose colour and power cannot be told
        if len(self._fisheye) != 3 or self._said_sharp:
            return
        for cell in brightest_cells(radiance, self._settings.coverage):
            pixels = np.concatenate([w.pixel[w.by_cell[w.start[cell] : w.start[cell + 1]]] for w in self._fisheye]).astype(np.int64)
            brightest = int(pixels[brightness(pixels).argmax()])
            if is_sharper_than_mosaic(brightness, brightest, self._fisheye[0].shape):
                self._said_sharp = True
                row, column = divmod(brightest, self._fisheye[0].shape[1])
                where = f"a light at pixel {column}, {row} is sharper than the mosaic"
                notice(f"{name}: {where}: its power and colour may be off by half and more")
                return

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
            case "cube3x2":
                self._check_cube(name, shape)
            case _:
                raise _unknown_kind(name, kind)

    def check_codes(self, name: str, shape: tuple[int, ...]) -> None:
        """Raises UserError for raw codes without lens or response, or of another size than the lens."""
        self._check_lens(name, shape)
        self.checked_response(name)

    def _kind(self, attributes: dict[str, Any]) -> Any:
        of_lens = "latlong" if not self._lenses else "fisheye" if self._response is None else "codes"
        said = {"equirect": "latlong", "cube3x2": "cube3x2"}.get(self._settings.projection or "", of_lens)
        return attributes.get("vemlight:kind", said)

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

    def _check_latlong(self, name: str, shape: tuple[int, ...]) -> None:
        height, width = shape[:2]
        if abs(width - 2 * height) > MAX_LATLONG_EXCESS and not (self._settings.projection or self._settings.span):
            fisheye = "a fisheye frame needs lens.toml beside it, or its lens by --lens or [capture] lens"
            others = "say --projection equirect, with --span where it is a part of the sphere, or cube3x2"
            raise UserError(
                f"{name}: is {width}x{height} and a lat-long map of the whole sphere is twice as wide as high; {fisheye}; else {others}"
            )

    @staticmethod
    def _check_cube(name: str, shape: tuple[int, ...]) -> None:
        height, width = shape[:2]
        if not is_cube(width, height):
            raise UserError(f"{name}: is {width}x{height} and cube3x2 has three square faces by two; choose another --projection")

    def _latlong_weights(self, name: str, shape: tuple[int, ...]) -> LatlongToPolar:
        s = self._settings
        self._check_latlong(name, shape)
        if self._latlong is None:
            self._latlong = latlong_to_polar(shape[0], shape[1], s.rows, s.cols, s.coverage, s.span or WHOLE_SPHERE)
        return self._latlong

    def _from_latlong(self, name: str, image: np.ndarray) -> tuple[np.ndarray, BrightCells]:
        weights, coverage = self._latlong_weights(name, image.shape), self._settings.coverage
        radiance = polar_from_latlong(image, weights)
        return radiance, latlong_bright_cells(image, weights, brightest_cells(radiance, coverage), coverage)

    def _from_pixels(self, image: np.ndarray) -> tuple[np.ndarray, BrightCells]:
        radiance, flat = polar_from_fisheye(image, self._fisheye[0], self._threads), image.reshape(-1, 3)
        return radiance, self._bright_cells(radiance, lambda pixel: luminance_from_rgb(flat[pixel]))

    def checked_response(self, name: str) -> Response:
        """The sensor's response. Raises UserError, with the frame's `name`, when there is none."""
        if self._response is None:
            where = "name it by --response or [capture] response"
            raise UserError(f"{name}: holds raw codes, which need a response file, and {self._response_path} is not there; {where}")
        return self._response

    def _calibrated(self, name: str) -> tuple[Response, np.ndarray]:
        # the response, and its radiance of each of ALL_CODES; those above its range repeat the highest
        response = self.checked_response(name)
        if self._table is None:
            known = radiance_table(response)
            self._table = np.concatenate([known, np.full(ALL_CODES - len(known), known[-1], np.float32)])
        return response, self._table

    def _check_shape(self, name: str, shape: tuple[int, ...]) -> None:
        height, width = shape[:2]
        if self._shape is None:
            self._shape = height, width
        if self._shape != (height, width):
            size = f"{self._shape[1]}x{self._shape[0]}"
            raise UserError(f"{name}: is {width}x{height} and the frames before it {size}; a sequence has one size")

    def _check_lens(self, name: str, shape: tuple[int, ...]) -> None:
        height, width = shape[:2]
        if not self._lenses:
            where = "name it by --lens or [capture] lens"
            raise UserError(f"{name}: is a fisheye frame, which needs a lens file, and {self._lens_path} is not there; {where}")
        own = next(lens.size for lens in self._lenses)
        if own != (width, height):
            size = f"{own[0]}x{own[1]}"
            first_path = next(iter(self._lens_paths))
            which = "the lens file is" if len(self._lenses) == 1 else f"the lens files, {first_path} first, are"
            raise UserError(f"{name}: is {width}x{height} and {which} for {size}; give the lens file of this camera")

    def _prepare(self, name: str, shape: tuple[int, ...], mosaic: Mosaic | None, kind: str = "fisheye") -> None:
        # computes the weights for images like this one
        if self._fisheye:
            return
        s = self._settings
        if kind == "cube3x2":
            self._check_cube(name, shape)
            side = shape[0] // 2
            self._fisheye, self._directions = [cube_to_polar(side, s.rows, s.cols, s.coverage)], partial(cube_directions, side=side)
        else:
            self._check_lens(name, shape)
            lattices = [ALL_PIXELS] if mosaic in (None, "mono") else colour_lattices(mosaic)
            flat_fields = [flat_field(lens, path) for lens, path in zip(self._lenses, self._lens_paths, strict=True)]
            self._fisheye = [lenses_to_polar(self._lenses, s.rows, s.cols, s.coverage, lattice, flat_fields) for lattice in lattices]
            if not any(len(weights.pixel) for weights in self._fisheye):
                named = ", ".join(str(path) for path in self._lens_paths)
                seen = f"no pixel of the frame looks into the {s.coverage}"
                raise UserError(f"{named}: {seen}; correct c, f, rim_deg (degrees) or world_from_camera")
            self._directions = partial(directions_of, self._lenses)
            self._directions(np.zeros((1, 2)))  # compiles it now, and not when the first bright cell appears
        self._spans, self._runs = lit_spans(self._fisheye), lit_runs(self._fisheye)

    def _bright_cells(self, radiance: np.ndarray, brightness: Callable[[np.ndarray], np.ndarray]) -> BrightCells:
        weights, coverage = self._fisheye[1 if len(self._fisheye) == 3 else 0], self._settings.coverage
        return fisheye_bright_cells(brightness, weights, self._directions, brightest_cells(radiance, coverage), coverage)


def brightest_cells(radiance: np.ndarray, coverage: Coverage) -> np.ndarray:
    """Cells of a polar map with more than BRIGHT_FRACTION of its power, brightest first, at most MAX_BRIGHT_CELLS.

    Returns flat indices (n,) int32. Cells that are not finite or negative count as dark.
    """
    rows, cols, _ = radiance.shape
    flux = (luminance_from_rgb(radiance) * cell_solid_angles(rows, cols, coverage)[:, None].astype(np.float32)).ravel()
    flux[~(flux > 0) | ~np.isfinite(flux)] = 0
    bright = np.flatnonzero(flux > BRIGHT_FRACTION * flux.sum(dtype=np.float64))
    return bright[np.argsort(-flux[bright], kind="stable")][:MAX_BRIGHT_CELLS].astype(np.int32)


def _unknown_kind(name: str, kind: Any) -> UserError:
    return UserError(f"{name}: vemlight:kind = {str(kind)[:40]!r} is not known; it is latlong, fisheye, cube3x2, codes or polar")
