"""The light meter against evalglare: python -m bench.photometry EVALGLARE MAP...

EVALGLARE is Radiance's program (pyradiance's wheel has it); each MAP a lat-long. Every map is scaled to several vertical illuminances and
looked at in four directions. evalglare sees the same cells as a fisheye picture of 800 x 800, and the map itself at its own resolution,
which tells what the cells cost.
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
from vemlight.light.map_elements import elements_from_map, plane_irradiance
from vemlight.light.sphere import cell_from_direction, latlong_from_direction
from vemlight.settings import Capture
from vemlight.viewer.meter import Look

SIDE = 800  # pixels of the fisheye
EFFICACY = 179.0  # lm/W, by which Radiance's programs make luminance of radiance
LOOKS = tuple(Look(azimuth, 0) for azimuth in (0, 90, 180, 270))
ILLUMINANCES_LX = (600.0, 2000.0, 6000.0)


def fisheye_directions(look: Look) -> tuple[np.ndarray, np.ndarray]:
    """Directions (SIDE, SIDE, 3) of an equidistant fisheye of 180 degrees, and which pixels are inside it."""
    across = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
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


def glare_of(environment: EnvironmentMap, look: Look, scale: float) -> tuple[float, float]:
    """DGP and vertical illuminance of a map of which a unit is `scale` cd/m2."""
    elements = elements_from_map(environment)
    illuminance = float(luminance_from_rgb(plane_irradiance(elements, look.direction))) * scale
    sources = glare_sources(elements, luminance_from_rgb(elements.radiance) * np.float32(scale), look.direction)
    return glare_probability(illuminance, sources, look.direction, look.up), illuminance


def pictures(radiance: np.ndarray, fine: np.ndarray, look: Look, scale: float) -> list[np.ndarray]:
    """What a fisheye sees, in cd/m2, of a map's cells (rows, cols, 3) and of a lat-long (height, width) of luminance."""
    directions, inside = fisheye_directions(look)
    row, col = (part.astype(np.int64) for part in cell_from_direction(directions, *radiance.shape[:2], "sphere"))
    i, j = (part.astype(np.int64) for part in latlong_from_direction(directions, *fine.shape))
    return [luminance_from_rgb(radiance)[row, col % radiance.shape[1]] * scale * inside, fine[i, j] * scale * inside]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("evalglare", type=Path)
    parser.add_argument("maps", type=Path, nargs="+")
    asked = parser.parse_args()
    worst = np.zeros(3)
    print("| map | azimuth | cells: E_v | evalglare | DGP | evalglare | with bright cells: DGP | evalglare on the map |")
    for path in asked.maps:
        frame = open_source(Capture(source=str(path), coverage="sphere", rows=180)).frame(0)
        cells, bright = EnvironmentMap(frame.radiance, "sphere"), EnvironmentMap(frame.radiance, "sphere", frame.bright_cells)
        fine = luminance_from_rgb(read_radiance(path)[0])
        for look, illuminance in zip(LOOKS, np.resize(ILLUMINANCES_LX, len(LOOKS)), strict=True):
            scale = illuminance / glare_of(cells, look, 1.0)[1]
            (dgp, lux), dgp_bright = glare_of(cells, look, scale), glare_of(bright, look, scale)[0]
            (dgp_cells, lux_cells), (dgp_map, _) = (evalglare(asked.evalglare, seen) for seen in pictures(frame.radiance, fine, look, scale))
            worst = np.maximum(worst, np.abs([lux_cells / lux - 1, dgp / dgp_cells - 1, dgp_bright / dgp_map - 1]))
            numbers = f"{lux:.1f} | {lux_cells:.1f} | {dgp:.4f} | {dgp_cells:.4f} | {dgp_bright:.4f} | {dgp_map:.4f}"
            print(f"| {path.stem} | {look.azimuth:g} | {numbers} |", flush=True)
    print(f"largest departures: illuminance {worst[0]:.2%}, DGP of cells {worst[1]:.2%}, DGP of the map {worst[2]:.2%}")


if __name__ == "__main__":
    main()
