"""What a luminaire file holds: in lines of text, in pictures, and as intensity by angle."""

from pathlib import Path

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.far_field import FarField, intensity, total_flux_lm
from vemlight.light.images import write_png
from vemlight.light.photometry import PHOTOMETRY_SUFFIXES, read_photometry
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.luminaire.estimator import interleaved_shifts, irradiance_receivers, shade
from vemlight.renderer.luminaire.lightfield import LightField, far_intensity, flux
from vemlight.renderer.luminaire.luminaire_file import read_luminaire
from vemlight.renderer.luminaire.method_choice import EQUAL_SAMPLES, chosen_method
from vemlight.renderer.luminaire.shift_invariant import error_bound
from vemlight.renderer.luminaire.tables import summed_area_tables

PLANE_SAMPLES = 2000  # a point of a lit plane: a grain of about 1 %; any value in 500..10000 does
PLANE_DISTANCES = (1, 5, 20)  # of the pictured planes, in distances between the light field's planes: near, usual, far
WHITE_QUANTILE = 0.999  # of the pixels' magnitudes, white in a contact sheet; any value in 0.99..0.9999 does
GRID_LEVEL = 60  # of 255: the lines between the images of a contact sheet; any value in 20..120 does


def describe(path: Path, lamp_set: int = 0) -> list[str]:
    """`vemlight luminaire show LAMP`: lines about a light field (.exr) or a far field (.ldt, .ies)."""
    if path.suffix.lower() in PHOTOMETRY_SUFFIXES:
        far = read_photometry(path, lamp_set)
        return [
            f"{far.name}: far field, {len(far.c_deg)} C planes x {len(far.gamma_deg)} angles, {far.candela.max():.4g} cd at most",
            f"flux {total_flux_lm(far):.5g} lm" + ("" if np.isnan(far.lamp_flux_lm) else f" of {far.lamp_flux_lm:.5g} lm of the lamps"),
            f"luminous area {' x '.join(f'{side:.3g}' for side in far.size_m)} m: a point from {far.valid_from_m:.3g} m on",
        ]
    field = read_luminaire(path)
    rows, cols, height, width, _ = field.images.shape
    flux_unit = "lm" if field.unit == "photometric" else "W"
    drawn = chosen_method(field, "auto", None)
    if np.isnan(drawn.sampling_error):
        tried = ""
    else:
        tried = f", on walls {drawn.shift_invariant_error:.2%}; of {EQUAL_SAMPLES} samples {drawn.sampling_error:.2%}"
    method = "shift-invariant" if drawn.shift_invariant else f"with {drawn.samples} samples a pixel"
    return [
        f"{field.name}: light field, {rows} x {cols} images of {width} x {height}, {field.basis_kind} basis, {field.unit}",
        f"spacing {field.spacing_m * 1e3:.4g} mm, planes {field.distance_m * 1e3:.4g} mm apart, "
        f"window {(field.window_m[2] - field.window_m[0]) * 1e3:.4g} x {(field.window_m[3] - field.window_m[1]) * 1e3:.4g} mm",
        f"flux {float(luminance_from_rgb(flux(field))):.5g} {flux_unit}",
        f"error of the shift-invariant approximation at most {error_bound(field):.2%}{tried}: rendered {method} by default",
    ]


def contact_sheet(field: LightField) -> np.ndarray:
    """All images side by side, (rows * height, cols * width, 3) uint8: v and t upwards, square root, white at WHITE_QUANTILE.

    Negative pixels are blue.
    """
    rows, cols, height, width, _ = field.images.shape
    sheet = field.images[::-1, :, ::-1].transpose(0, 2, 1, 3, 4).reshape(rows * height, cols * width, 3).astype(np.float64)
    white = max(float(np.quantile(np.abs(sheet), WHITE_QUANTILE)), 1e-30)
    level = np.sqrt(np.clip(sheet / white, 0, 1))
    level[..., 2] = np.maximum(level[..., 2], np.sqrt(np.clip(-luminance_from_rgb(sheet) / white, 0, 1)))
    picture = _eight_bits(level)
    picture[::height] = np.maximum(picture[::height], GRID_LEVEL)
    picture[:, ::width] = np.maximum(picture[:, ::width], GRID_LEVEL)
    return picture


def lit_planes(field: LightField, distances_m: tuple[float, ...], pixels: int = 64) -> np.ndarray:
    """Planes across the axis at distances from the sampling plane, side by side, (pixels, n * pixels, 3) uint8.

    Each is as wide as the light field's window reaches there and exposed for its brightest pixel; square root.
    """
    tables = summed_area_tables(field)
    spread = max(field.window_m[2] - field.window_m[0], field.window_m[3] - field.window_m[1]) / 2 / field.distance_m
    pictures = []
    for z in distances_m:
        along = ((np.arange(pixels) + 0.5) / pixels * 2 - 1) * spread * max(z, field.distance_m)
        x, y = np.meshgrid(along, along[::-1])
        points = np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=-1)
        shifts = interleaved_shifts(np.zeros(x.size, int), np.zeros(x.size, int), 1)
        lit = shade(tables, irradiance_receivers(points, np.tile([0.0, 0.0, -1.0], (x.size, 1))), shifts, PLANE_SAMPLES)
        pictures.append(np.sqrt(np.clip(lit / max(float(lit.max()), 1e-30), 0, 1)).reshape(pixels, pixels, 3))
    return _eight_bits(np.hstack(pictures))


def _eight_bits(level: np.ndarray) -> np.ndarray:
    return (level * 255 + 0.5).astype(np.uint8)


def intensity_by_angle(source: LightField | FarField, step_deg: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """(angle, intensity): degrees from the axis and intensity (luminance, mean round the axis), both (n,)."""
    theta = np.arange(0, 90 if isinstance(source, LightField) else 180 + step_deg, step_deg)
    phi = np.radians(np.arange(0, 360, 30.0))
    directions = direction_from_angles(np.radians(theta)[:, None], phi[None, :])
    if isinstance(source, FarField):
        return theta, intensity(source, directions).mean(axis=1)
    return theta, luminance_from_rgb(far_intensity(source, directions.reshape(-1, 3))).reshape(len(theta), -1).mean(axis=1)


def write_pictures(path: Path, folder: Path, lamp_set: int = 0) -> list[Path]:
    """`vemlight luminaire show LAMP --out FOLDER`: writes NAME_intensity.csv and, of a light field, NAME_images.png and NAME_planes.png."""
    folder.mkdir(parents=True, exist_ok=True)
    source = read_photometry(path, lamp_set) if path.suffix.lower() in PHOTOMETRY_SUFFIXES else read_luminaire(path)
    written = [folder / f"{path.stem}_intensity.csv"]
    rows = zip(*intensity_by_angle(source), strict=True)
    written[0].write_text("angle_deg,intensity\n" + "".join(f"{a:g},{i:.6g}\n" for a, i in rows))
    if isinstance(source, LightField):
        written += [folder / f"{path.stem}_images.png", folder / f"{path.stem}_planes.png"]
        write_png(written[1], contact_sheet(source))
        write_png(written[2], lit_planes(source, tuple(k * source.distance_m for k in PLANE_DISTANCES)))
    return written
