"""`vemlight luminaire`: light fields made from ray files and on the virtual bench, and what a luminaire is, in numbers and pictures."""

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import read_toml
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import write_png
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS, Kind, compact_dual, span_dual
from vemlight.renderer.luminaire.estimator import interleaving, receivers, shade
from vemlight.renderer.luminaire.goniophotometer import Lamp, measured_lamp
from vemlight.renderer.luminaire.lightfield import LightField, Unit, far_intensity, flux
from vemlight.renderer.luminaire.luminaire_file import Length, read_luminaire, write_luminaire
from vemlight.renderer.luminaire.measuring import Equipment, FluxBudget, Planes, field_from_rays, waist_z_m
from vemlight.renderer.luminaire.photometry import FarField, intensity, read_photometry, total_flux_lm
from vemlight.renderer.luminaire.rayfile import read_rays
from vemlight.renderer.luminaire.shift_invariant import GOOD_ENOUGH, error_bound
from vemlight.renderer.luminaire.tables import tables_of

Bits = Annotated[int, Meta(ge=0, le=16)]
Functions = Annotated[int, Meta(ge=1, le=32)]
Side = Annotated[int, Meta(ge=1, le=1024)]
RAY_SOURCE = 0.98  # of the flux that the sampling plane is made to hold when a ray file's size is not given


class PlanesTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The planes of a recipe: `measuring.Planes` with the file's own key for the basis."""

    basis: Kind = "bell"
    spacing_m: Length
    rows: Functions
    cols: Functions
    distance_m: Length
    half_window_m: tuple[Length, Length]
    width: Side
    height: Side

    def planes(self) -> Planes:
        return Planes(self.basis, self.spacing_m, self.rows, self.cols, self.distance_m, self.half_window_m, self.width, self.height)


class BenchRecipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the virtual bench measures and how. dual_width: of the compact dual, in spacings. half: the file's numbers are 16-bit."""

    name: str
    unit: Unit = "photometric"
    dual: Literal["span", "compact"] = "compact"
    dual_width: Annotated[float, Meta(ge=2, le=12)] = 4.0
    slide_bits: Bits = 0
    camera_bits: Bits = 0
    half: bool = False
    per_spacing: Annotated[int, Meta(ge=1, le=64)] = 10
    per_pixel: Annotated[int, Meta(ge=1, le=8)] = 2
    lamp: Lamp = Lamp()
    planes: PlanesTable


def measure(recipe: Path, out: Path) -> LightField:
    """`vemlight luminaire measure RECIPE.toml --out LAMP.exr`: the bench measures the recipe's lamp. Raises UserError for a bad recipe."""
    wanted = read_toml(recipe, BenchRecipe)
    planes = wanted.planes.planes()
    if wanted.dual == "compact" and wanted.dual_width < SUPPORT_CELLS[planes.kind]:
        least = SUPPORT_CELLS[planes.kind]
        raise UserError(f"{recipe}: dual_width {wanted.dual_width:g} is under the {least} spacings of the basis; widen it")
    dual = span_dual(planes.kind) if wanted.dual == "span" else compact_dual(planes.kind, wanted.dual_width)
    field = measured_lamp(wanted.lamp, planes, dual, unit=wanted.unit, name=wanted.name, per_spacing=wanted.per_spacing,
                          per_pixel=wanted.per_pixel, equipment=Equipment(wanted.slide_bits, wanted.camera_bits))
    if wanted.half and np.abs(field.images).max() > np.finfo(np.float16).max:
        raise UserError(f"{recipe}: half = true holds values to 65504 and the lamp reaches {np.abs(field.images).max():.3g}; take it out")
    write_luminaire(out, field._replace(images=field.images.astype(np.float16 if wanted.half else np.float32)))
    return field


class FromRays(NamedTuple):
    """A light field made of a ray file, and where the flux went. origin_m: the sampling plane's middle in the file's frame."""

    field: LightField
    ledger: FluxBudget
    header_flux: float
    origin_m: tuple[float, float, float]


def from_rays(path: Path, out: Path, *, basis: Kind = "bell", functions: int = 9, pixels: int = 48, angle_deg: float = 76.0,
              spacing_m: float | None = None, distance_m: float | None = None, plane_z_m: float | None = None) -> FromRays:
    """`vemlight luminaire from-rays RAYS --out LAMP.exr`: a TM-25 ray file as a light field.

    The sampling plane lies where the rays are least spread unless plane_z_m (in the file's frame) says otherwise, with its middle in the
    median of the flux; functions x functions
    basis functions hold 98 % of the flux with a spacing to each side to spare; the planes are 10 spacings apart; the window takes rays up
    to angle_deg from the axis. Raises UserError for a file that cannot be read or options that leave nothing.
    """
    if not (2 <= functions <= 32 and 1 <= pixels <= 1024 and 1 <= angle_deg <= 87):
        raise UserError(f"{path}: functions lie in 2..32, pixels in 1..1024 and the angle in 1..87 degrees; mend the option")
    file = read_rays(path)
    rays = file.rays
    ahead = rays.directions[:, 2] > np.cos(np.radians(angle_deg))
    if not ahead.any() or luminance_from_rgb(rays.flux[ahead]).sum() <= 0:
        raise UserError(f"{path}: no ray goes within {angle_deg:g} degrees of +z; turn the set or widen the angle")
    z = waist_z_m(rays._replace(flux=rays.flux * ahead[:, None])) if plane_z_m is None else plane_z_m
    crossing = rays.positions[ahead, :2] + (z - rays.positions[ahead, 2:]) * rays.directions[ahead, :2] / rays.directions[ahead, 2:]
    strength = luminance_from_rgb(rays.flux[ahead])
    x, y = (_quantile(along, strength, 0.5) for along in crossing.T)
    rays = rays._replace(positions=rays.positions - [x, y, 0.0])
    if spacing_m is None:
        half = _quantile(np.abs(crossing - [x, y]).max(axis=1), strength, RAY_SOURCE)
        spacing_m = float(max(half / max((functions - 3) / 2, 0.5), 1e-6))
    distance_m = distance_m or 10 * spacing_m
    edge = (functions / 2) * spacing_m + distance_m * float(np.tan(np.radians(angle_deg)))
    planes = Planes(basis, spacing_m, functions, functions, distance_m, (edge, edge), pixels, pixels)
    field, ledger = field_from_rays(rays, planes, z, "photometric" if file.photometric else "radiometric", file.name)
    write_luminaire(out, field)
    return FromRays(field, ledger, file.header_flux, (x, y, z))


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """The value below which `share` of the weight lies."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][min(np.searchsorted(total, share * total[-1]), len(values) - 1)])


def report(path: Path) -> list[str]:
    """`vemlight luminaire show LAMP`: lines about a light field (.exr) or a far field (.ldt, .ies)."""
    if path.suffix.lower() in (".ldt", ".ies"):
        far = read_photometry(path)
        return [f"{far.name}: far field, {len(far.c_deg)} C planes x {len(far.gamma_deg)} angles, {far.candela.max():.4g} cd at most",
                f"flux {total_flux_lm(far):.5g} lm of {far.lamp_flux_lm:.5g} lm of the lamps",
                f"luminous area {' x '.join(f'{side:.3g}' for side in far.size_m)} m: a point from {far.valid_from_m:.3g} m on"]
    field = read_luminaire(path)
    rows, cols, height, width, _ = field.images.shape
    bound = error_bound(field)
    name = "lm" if field.unit == "photometric" else "W"
    method = "shift-invariant" if bound <= GOOD_ENOUGH else "sampled"
    return [f"{field.name}: light field, {rows} x {cols} images of {width} x {height}, {field.kind} basis, {field.unit}",
            f"spacing {field.spacing_m * 1e3:.4g} mm, planes {field.distance_m * 1e3:.4g} mm apart, "
            f"window {(field.window_m[2] - field.window_m[0]) * 1e3:.4g} x {(field.window_m[3] - field.window_m[1]) * 1e3:.4g} mm",
            f"flux {float(luminance_from_rgb(flux(field))):.5g} {name}",
            f"error of the shift-invariant approximation at most {bound:.2%}: rendered {method} by default"]


def contact_sheet(field: LightField) -> np.ndarray:
    """All images side by side, (rows * height, cols * width, 3) uint8: v and t upwards, square root of the share of the 99.9th percentile;
    negative pixels are blue."""
    rows, cols, height, width, _ = field.images.shape
    sheet = field.images[::-1, :, ::-1].transpose(0, 2, 1, 3, 4).reshape(rows * height, cols * width, 3).astype(np.float64)
    top = max(float(np.quantile(np.abs(sheet), 0.999)), 1e-30)
    shown = np.sqrt(np.clip(sheet / top, 0, 1))
    shown[..., 2] = np.maximum(shown[..., 2], np.sqrt(np.clip(-luminance_from_rgb(sheet) / top, 0, 1)))
    shown = (shown * 255 + 0.5).astype(np.uint8)
    shown[::height] = np.maximum(shown[::height], 60)
    shown[:, ::width] = np.maximum(shown[:, ::width], 60)
    return shown


def lit_planes(field: LightField, distances_m: tuple[float, ...], pixels: int = 64) -> np.ndarray:
    """Planes across the axis at distances from the sampling plane, side by side, (pixels, n * pixels, 3) uint8; each as wide as the light
    field's window reaches there and exposed for its brightest pixel, square root."""
    tables, samples = tables_of(field), 2000  # a grain of about 1 %
    spread = max(field.window_m[2] - field.window_m[0], field.window_m[3] - field.window_m[1]) / 2 / field.distance_m
    pictures = []
    for z in distances_m:
        place = ((np.arange(pixels) + 0.5) / pixels * 2 - 1) * spread * max(z, field.distance_m)
        x, y = np.meshgrid(place, place[::-1])
        points = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=-1)
        shifts = interleaving(np.zeros(x.size, int), np.zeros(x.size, int), 1)
        lit = shade(tables, receivers(points, np.tile([0.0, 0.0, -1.0], (x.size, 1))), shifts, samples)
        pictures.append(np.sqrt(np.clip(lit / max(float(lit.max()), 1e-30), 0, 1)).reshape(pixels, pixels, 3))
    return (np.hstack(pictures) * 255 + 0.5).astype(np.uint8)


def intensity_by_angle(source: LightField | FarField, step_deg: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """(angle, intensity): degrees from the axis and intensity (luminance, mean round the axis), both (n,)."""
    theta = np.arange(0, 90 if isinstance(source, LightField) else 180 + step_deg, step_deg)
    phi = np.radians(np.arange(0, 360, 30.0))
    directions = direction_from_angles(np.radians(theta)[:, None], phi[None, :])
    if isinstance(source, FarField):
        return theta, intensity(source, directions).mean(axis=1)
    return theta, luminance_from_rgb(far_intensity(source, directions.reshape(-1, 3))).reshape(len(theta), -1).mean(axis=1)


def write_pictures(path: Path, folder: Path) -> list[Path]:
    """`vemlight luminaire show LAMP --out FOLDER`: NAME_images.png, NAME_planes.png (at 1, 5 and 20 times the distance of the planes) and
    NAME_intensity.csv; for a far field the last alone."""
    folder.mkdir(parents=True, exist_ok=True)
    far = path.suffix.lower() in (".ldt", ".ies")
    source = read_photometry(path) if far else read_luminaire(path)
    made = [folder / f"{path.stem}_intensity.csv"]
    rows = zip(*intensity_by_angle(source), strict=True)
    made[0].write_text("angle_deg,intensity\n" + "".join(f"{a:g},{i:.6g}\n" for a, i in rows))
    if isinstance(source, LightField):
        made += [folder / f"{path.stem}_images.png", folder / f"{path.stem}_planes.png"]
        write_png(made[1], contact_sheet(source))
        write_png(made[2], lit_planes(source, tuple(k * source.distance_m for k in (1, 5, 20))))
    return made
