"""The light meter against evalglare: python -m bench.photometry EVALGLARE MAP...

EVALGLARE is Radiance's program (pyradiance's wheel has it); each MAP a lat-long. Every map is scaled to several vertical illuminances and
looked at in four directions, as a fisheye picture that evalglare reads. Compared are the formulas on the very pixels of that picture, and
what the meter says of a polar map of 180 x 360 cells, which tells what the cells cost.
"""

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from vemlight.capture.source import open_source
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.glare import glare_probability, glare_sources
from vemlight.light.images import read_radiance
from vemlight.light.map_elements import MapElements, elements_from_map, plane_irradiance
from vemlight.light.sphere import latlong_from_direction
from vemlight.settings import Capture
from vemlight.viewer.meter import Look

SIDE, OVER = 700, 4  # pixels of the fisheye, each the mean of OVER x OVER samples
EFFICACY = 179.0  # lm/W, by which Radiance's programs make luminance of radiance
LOOKS = tuple(Look(azimuth, 0) for azimuth in (0, 90, 180, 270))
ILLUMINANCES_LX = (600.0, 2000.0, 6000.0)


def fisheye_directions(look: Look, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (side, side, 3) of an equidistant fisheye of 180 degrees, and which pixels are inside it."""
    across = (np.arange(side) + 0.5) / side * 2 - 1
    right, up = across[None], -across[:, None]
    radius = np.hypot(right, up)
    ahead, beside = np.cos(radius * np.pi / 2), np.sinc(radius / 2) * np.pi / 2  # sin(r pi / 2) / r
    axes = np.stack([look.direction, np.cross(look.direction, look.up), look.up])
    return np.stack([ahead, right * beside, up * beside], axis=-1) @ axes, radius <= 1


def evalglare(program: Path, luminance: np.ndarray) -> tuple[float, float]:
    """DGP and vertical illuminance of a fisheye picture (SIDE, SIDE) in cd/m2."""
    mantissa, exponent = np.frexp(np.maximum(luminance / EFFICACY, 1e-30))
    level = np.where(luminance > 0, mantissa * 256, 0).astype(np.uint8)
    pixels = np.stack([level, level, level, np.where(luminance > 0, exponent + 128, 0).astype(np.uint8)], axis=-1)
    head = f"#?RADIANCE\nVIEW= -vta -vd 1 0 0 -vu 0 0 1 -vh 180 -vv 180\nFORMAT=32-bit_rle_rgbe\n\n-Y {SIDE} +X {SIDE}\n"
    with tempfile.NamedTemporaryFile(suffix=".hdr") as file:
        file.write(head.encode() + pixels.tobytes())
        file.flush()
        answer = subprocess.run([program, "-d", file.name], capture_output=True, text=True, check=True).stdout
    values = answer.splitlines()[-1].split(": ")[1].split()
    return float(values[0]), float(values[2])


def glare_of(elements: MapElements, look: Look, scale: float) -> tuple[float, float]:
    """DGP and vertical illuminance of parts of the sphere of which a unit is `scale` cd/m2."""
    illuminance = float(luminance_from_rgb(plane_irradiance(elements, look.direction))) * scale
    sources = glare_sources(elements, luminance_from_rgb(elements.radiance) * np.float32(scale), look.direction)
    return glare_probability(illuminance, sources, look.direction, look.up), illuminance


def fisheye(image: np.ndarray, look: Look) -> tuple[np.ndarray, MapElements]:
    """What a fisheye sees of a lat-long (height, width, 3): its picture (SIDE, SIDE) of luminance, and its pixels as elements."""
    directions, inside = fisheye_directions(look, SIDE)
    finer, _ = fisheye_directions(look, OVER * SIDE)
    row, col = (part.astype(np.int64) for part in latlong_from_direction(finer, *image.shape[:2]))
    seen = image[row, col].reshape(SIDE, OVER, SIDE, OVER, 3).mean(axis=(1, 3)) * inside[..., None]
    from_axis = np.arccos(np.clip(directions @ look.direction, -1, 1))
    solid_angles = np.sinc(from_axis / np.pi) * (np.pi / SIDE) ** 2 * inside
    flat = (directions.reshape(-1, 3).astype(np.float32), solid_angles.ravel().astype(np.float32), seen.reshape(-1, 3))
    return luminance_from_rgb(seen), MapElements(*flat, np.arange(SIDE * SIDE), SIDE, SIDE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("evalglare", type=Path)
    parser.add_argument("maps", type=Path, nargs="+")
    asked = parser.parse_args()
    worst = np.zeros(4)
    print("| map | azimuth | E_v of the same pixels | evalglare | DGP of the same pixels | evalglare | E_v of the map | DGP of the map |")
    for path in asked.maps:
        frame, image = open_source(Capture(source=str(path), coverage="sphere", rows=180)).frame(0), read_radiance(path)[0]
        cells = elements_from_map(EnvironmentMap(frame.radiance, "sphere", frame.bright_cells))
        for look, illuminance in zip(LOOKS, np.resize(ILLUMINANCES_LX, len(LOOKS)), strict=True):
            picture, pixels = fisheye(image, look)
            scale = illuminance / glare_of(pixels, look, 1.0)[1]
            (dgp, lux), (dgp_map, lux_map) = glare_of(pixels, look, scale), glare_of(cells, look, scale)
            dgp_by, lux_by = evalglare(asked.evalglare, picture * scale)
            worst = np.maximum(worst, np.abs([lux_by / lux - 1, dgp / dgp_by - 1, lux_map / lux_by - 1, dgp_map / dgp_by - 1]))
            numbers = f"{lux:.1f} | {lux_by:.1f} | {dgp:.4f} | {dgp_by:.4f} | {lux_map:.1f} | {dgp_map:.4f}"
            print(f"| {path.stem} | {look.azimuth:g} | {numbers} |", flush=True)
    names = ("E_v", "DGP of the same pixels", "E_v of the map's cells", "DGP of the map's cells")
    print("largest departures from evalglare: " + ", ".join(f"{name} {value:.2%}" for name, value in zip(names, worst, strict=True)))


if __name__ == "__main__":
    main()
