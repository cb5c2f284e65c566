"""Making light field files: from a recipe for the virtual goniophotometer, and from measured ray files."""

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import read_toml
from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.luminaire.acquisition import AcquisitionPlanes, FluxBudget, Quantisation, field_from_rays, waist_z_m
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS, BasisKind, compact_dual, span_dual
from vemlight.renderer.luminaire.goniophotometer import ReflectorLamp, measured_lamp
from vemlight.renderer.luminaire.lightfield import LightField, Unit
from vemlight.renderer.luminaire.luminaire_file import Length, write_luminaire
from vemlight.renderer.luminaire.rayfile import read_rays

Bits = Annotated[int, Meta(ge=0, le=16)]
FunctionCount = Annotated[int, Meta(ge=1, le=32)]
PixelCount = Annotated[int, Meta(ge=1, le=1024)]
MAX_MADE_UP = 0.05  # of a lamp's flux, made up for though it leaves elsewhere: as much as meters differ. 0.03 to 0.1 do
FLUX_ON_PLANE = 0.98  # fraction of a ray file's flux that the basis functions reach to where no spacing is given
DISTANCE_SPACINGS = 10  # between the planes where none is given; any value in 5..30 does: nearer ones blur directions


class PlanesTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The `[planes]` of a recipe: an AcquisitionPlanes, with the file's own key for the basis."""

    basis: BasisKind = "bell"
    spacing_m: Length
    rows: FunctionCount
    cols: FunctionCount
    distance_m: Length
    half_window_m: tuple[Length, Length]
    width: PixelCount
    height: PixelCount

    def planes(self) -> AcquisitionPlanes:
        """The record that acquisition works with."""
        window = self.half_window_m
        return AcquisitionPlanes(self.basis, self.spacing_m, self.rows, self.cols, self.distance_m, window, self.width, self.height)


class GoniophotometerRecipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What the virtual goniophotometer measures and how.

    dual_width: of the compact dual, in spacings. half: the file's numbers are 16-bit. per_spacing, per_pixel: places of the midpoint rule.
    """

    name: str
    unit: Unit = "photometric"
    dual: Literal["span", "compact"] = "compact"
    dual_width: Annotated[float, Meta(ge=2, le=12)] = 4.0
    slide_bits: Bits = 0
    camera_bits: Bits = 0
    half: bool = False
    per_spacing: Annotated[int, Meta(ge=1, le=64)] = 10
    per_pixel: Annotated[int, Meta(ge=1, le=8)] = 2
    lamp: ReflectorLamp = ReflectorLamp()
    planes: PlanesTable


def measure(path: Path, out: Path) -> LightField:
    """`vemlight luminaire measure RECIPE.toml --out LAMP.exr`: measures the recipe's lamp. Raises UserError for a bad recipe."""
    recipe = read_toml(path, GoniophotometerRecipe)
    planes = recipe.planes.planes()
    if recipe.dual == "compact" and recipe.dual_width < SUPPORT_CELLS[planes.basis_kind]:
        support = SUPPORT_CELLS[planes.basis_kind]
        raise UserError(f"{path}: dual_width {recipe.dual_width:g} is under the {support} spacings of the basis; widen it")
    dual = span_dual(planes.basis_kind) if recipe.dual == "span" else compact_dual(planes.basis_kind, recipe.dual_width)
    field = measured_lamp(recipe.lamp, planes, dual, unit=recipe.unit, name=recipe.name, per_spacing=recipe.per_spacing,
                          per_pixel=recipe.per_pixel, quantisation=Quantisation(recipe.slide_bits, recipe.camera_bits))
    if recipe.half and np.abs(field.images).max() > np.finfo(np.float16).max:
        raise UserError(f"{path}: half = true holds values to 65504 and the lamp reaches {np.abs(field.images).max():.3g}; take it out")
    write_luminaire(out, field._replace(images=field.images.astype(np.float16 if recipe.half else np.float32)))
    return field


class RayConversion(NamedTuple):
    """A light field made of a ray file, and where the flux went.

    origin_m: the sampling plane's middle in the file's frame. factor: by which what was captured is multiplied, to make up for the rest.
    """

    field: LightField
    flux_budget: FluxBudget
    header_flux: float
    origin_m: tuple[float, float, float]
    factor: float


class RayOptions(msgspec.Struct, frozen=True, kw_only=True):
    """How a ray file becomes a light field of functions x functions images of pixels x pixels. None: as the rays need (`from_rays`).

    angle_deg: from the axis, that the window of the measurement plane takes in. plane_z_m: of the sampling plane, in the file's frame.
    """

    basis: BasisKind = "bell"
    functions: int = 9
    pixels: int = 48
    angle_deg: float = 76.0
    spacing_m: float | None = None
    distance_m: float | None = None
    plane_z_m: float | None = None


DEFAULT_RAY_OPTIONS = RayOptions()


def from_rays(path: Path, out: Path, options: RayOptions = DEFAULT_RAY_OPTIONS) -> RayConversion:
    """`vemlight luminaire from-rays RAYS --out LAMP.exr`: converts a TM-25 ray file to a light field.

    Unless the options say otherwise, the sampling plane lies where the beam is narrowest, its middle at the median of the flux, and the
    planes are DISTANCE_SPACINGS apart. The basis functions reach over FLUX_ON_PLANE of the flux with a spacing of margin on each side.
    Raises UserError for a file that cannot be read or options that leave nothing.
    """
    functions, angle_deg = options.functions, options.angle_deg
    if not (2 <= functions <= 32 and 1 <= options.pixels <= 1024 and 1 <= angle_deg <= 87):
        raise UserError(f"{path}: functions lie in 2..32, pixels in 1..1024 and the angle in 1..87 degrees; correct the option")
    file = read_rays(path)
    rays = file.rays
    ahead = rays.directions[:, 2] > np.cos(np.radians(angle_deg))
    if not ahead.any() or luminance_from_rgb(rays.flux[ahead]).sum() <= 0:
        raise UserError(f"{path}: no ray goes within {angle_deg:g} degrees of +z; turn the set or widen the angle")
    # the sampling plane: its height, middle and extent
    z = waist_z_m(rays._replace(flux=rays.flux * ahead[:, None])) if options.plane_z_m is None else options.plane_z_m
    crossing = rays.positions[ahead, :2] + (z - rays.positions[ahead, 2:]) * rays.directions[ahead, :2] / rays.directions[ahead, 2:]
    strength = luminance_from_rgb(rays.flux[ahead])
    x, y = (_weighted_quantile(along, strength, 0.5) for along in crossing.T)
    rays = rays._replace(positions=rays.positions - [x, y, 0.0])
    spacing_m = options.spacing_m
    if spacing_m is None:
        half = _weighted_quantile(np.abs(crossing - [x, y]).max(axis=1), strength, FLUX_ON_PLANE)
        spacing_m = float(max(half / max((functions - 3) / 2, 0.5), 1e-6))
    # the measurement plane: a window that takes in the angle from the farthest function
    distance_m = options.distance_m or DISTANCE_SPACINGS * spacing_m
    edge = (functions / 2) * spacing_m + distance_m * float(np.tan(np.radians(angle_deg)))
    planes = AcquisitionPlanes(options.basis, spacing_m, functions, functions, distance_m, (edge, edge), options.pixels, options.pixels)
    field, budget = field_from_rays(rays, planes, z, "photometric" if file.photometric else "radiometric", file.name)
    factor = made_up(budget)
    field = field._replace(images=field.images * factor)
    write_luminaire(out, field)
    return RayConversion(field, budget, file.header_flux, (x, y, z), factor)


def made_up(budget: FluxBudget) -> float:
    """By what a light field is multiplied so that it has the flux of the rays that were measured.

    All that goes forward, where little of it is lost. Where much is, such as at a narrow angle, what leaves beyond the measurement plane
    stays lost, as it would brighten the beam; what the filters and the sampling plane take is made up for all the same.
    """
    if budget.captured <= 0:
        return 1.0
    forward = budget.total - budget.backward
    if forward <= (1 + MAX_MADE_UP) * budget.captured:
        return forward / budget.captured
    return (budget.captured + budget.outside_sampling_plane + budget.filter_tails) / budget.captured


def _weighted_quantile(values: np.ndarray, weights: np.ndarray, fraction: float) -> float:
    """The value below which `fraction` of the weight lies."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][min(np.searchsorted(total, fraction * total[-1]), len(values) - 1)])
