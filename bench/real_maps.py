"""The whole pipeline on real maps: VEMLIGHT_DATA=FOLDER python bench/real_maps.py OUT [FRAMES]

Each map is rotated slowly, once as a folder of lat-long files and once through the virtual camera, with 72 lights, in lossless mode. Writes
contact sheets and figures.csv to OUT: order of the frames, energy of the lights against the map's integral and against the source's.
"""

import csv
import os
import shutil
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import tomli_w

from vemlight.capture.source import open_source
from vemlight.light.images import read_radiance, write_exr
from vemlight.light.light_set import LightsRow
from vemlight.light.sphere import latlong_solid_angles, map_irradiance
from vemlight.settings import Capture

MAPS = ("kloppenheim_05", "rooitou_park", "potsdamer_platz", "studio_small_03", "aerodynamics_workshop")
TURN_PIXELS = 2  # a frame; 0.7 degrees of 1024 pixels
LENS = """
size = [640, 640]
f = [200.0, 200.0]
c = [319.5, 319.5]
k1 = -0.01
k2 = 0.0
k3 = 0.0
k4 = 0.0
rim_deg = 92.0
vignetting = [-0.04]
"""
RESPONSE = """
kind = "log"
bits = 12
a = 1200.0
b = 180.0
c = 0.002
"""
SCENE = """
[camera]
from = [2.2, -3.4, 2.2]
at = [0.0, 0.0, 0.35]
fov_y = 28.0
[[mesh]]
shape = "plane"
scale = 4.0
material = {diffuse = [0.5, 0.5, 0.5]}
[[mesh]]
file = "suzi.glb"
y_up = true
scale = 0.6
rotate = [0.0, 0.0, 20.0]
at = [0.0, 0.0, 0.402]
material = {diffuse = [0.6, 0.5, 0.4], specular = [0.04, 0.04, 0.04], exponent = 40.0}
"""


def turned_maps(source: Path, folder: Path, frames: int) -> Path:
    image, _ = read_radiance(source)
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(frames):
        write_exr(folder / f"map_{k:04d}.exr", np.roll(image, -TURN_PIXELS * k, axis=1))
    return folder


def simulated(source: Path, folder: Path, frames: int) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in (("lens_in.toml", LENS), ("response_in.toml", RESPONSE)):
        (folder.parent / name).write_text(text)
    turn = 360 * TURN_PIXELS / read_radiance(source)[0].shape[1]
    vemlight(
        "simulate", source, "--lens", folder.parent / "lens_in.toml", "--response", folder.parent / "response_in.toml",
        "--out", folder, "--frames", frames, "--rotate", turn, "--noise", 0.5,
    )  # fmt: skip
    return folder


def vemlight(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "vemlight", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def played(source: Path, scene: Path, out: Path, frames: int) -> dict[str, float]:
    """Runs all services on `source` and compares their output with the input."""
    settings = out.parent / f"{out.name}.toml"
    content = {
        "capture": {"source": str(source.resolve())},
        "sampler": {"count": 72},
        "renderer": {"scene": str(scene.resolve()), "width": 320, "height": 240},
        "viewer": {"port": 8090},
    }
    settings.write_text(tomli_w.dumps(content))
    vemlight("run", settings, "--out", out, "--frames", frames)
    rows = [msgspec.json.decode(line, type=LightsRow) for line in (out / "lights.jsonl").read_bytes().splitlines()]
    assert [row.sequence for row in rows] == list(range(frames)), "not every frame's lights are there, once and in order"
    assert len(list(out.glob("frame_*.png"))) == frames, "pictures are missing"
    maps = open_source(Capture(source=str(source)))
    worst = 0.0
    for k in range(0, frames, 7):
        expected = map_irradiance(maps.frame(k).radiance, "hemisphere")
        found = np.array([light.irradiance for light in rows[k].lights], np.float32).sum(axis=0, dtype=float)
        worst = max(worst, float(np.abs(found / expected - 1).max()))
    return {"energy_error": worst, "irradiance": float(map_irradiance(maps.frame(0).radiance, "hemisphere")[1])}


def main(out: Path, frames: int) -> None:
    data = Path(os.environ["VEMLIGHT_DATA"])
    out.mkdir(parents=True, exist_ok=True)
    scene = out / "scene.toml"
    shutil.copyfile(data / "models" / "suzi.glb", scene.with_name("suzi.glb"))
    scene.write_text(SCENE)
    with open(out / "figures.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["map", "way", "worst energy error, lights against map", "map against source"])
        for name in MAPS:
            source = data / "hdri" / f"{name}_1k.hdr"
            image, _ = read_radiance(source)
            above = slice(0, len(image) // 2)
            truth = image[above, :, 1].sum(axis=1, dtype=float) @ latlong_solid_angles(*image.shape[:2])[above]
            for way, make in (("latlong", turned_maps), ("simulated", simulated)):
                seen = played(make(source, out / f"{name}_{way}_in", frames), scene, out / f"{name}_{way}", frames)
                row = [name, way, f"{seen['energy_error']:.1e}", f"{seen['irradiance'] / truth - 1:+.4f}"]
                table.writerow(row)
                file.flush()
                print(*row, flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 48)
