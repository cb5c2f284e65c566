"""A recording of a rig in a made-up room, to try `vemlight locate` on, and a picture of what was located, over the cameras' views:

    python -m bench.near_rig OUT [--seed 3] [--cameras 3] [--frames 8]
    vemlight locate OUT/rig.toml --out OUT/lights.jsonl
    python -m bench.near_rig OUT --draw OUT/lights.jsonl [--picture OUT/located.png]

OUT is a folder that is not there yet. The room is one of tests/support/analytic_rooms.py, with noise of 2 % a cell, and poses as wrong as
the rig file declares. The first command prints where the lamps are, the last one how far from them they were located.
"""

import argparse
import json
from pathlib import Path

import cv2
import msgspec
import numpy as np

from tests.support.analytic_rooms import PAIR, SQUARE, TRIANGLE, kept_room, maps_of, noisy, rig_of
from tests.support.rig_recordings import write_rig
from vemlight import settings
from vemlight.capture.source import open_source
from vemlight.fuse.rig_file import CameraRig, read_camera_rig
from vemlight.light.images import write_png
from vemlight.light.sphere import cell_from_direction, direction_from_angles
from vemlight.settings_file import section_from_options

RIGS = {2: PAIR, 3: TRIANGLE, 4: SQUARE}
SIZE, RIM = 400, 10  # pixels of a camera's view and around it
RING, TEXT, INK = 11, 68, (80, 220, 255)  # pixels: radius, and width of a distance; RGB
WHITE = 0.9  # the quantile of a view that is shown at half of full brightness


def record(out: Path, seed: int, cameras: int, frames: int) -> None:
    """Writes OUT/rig.toml, a folder of maps for each camera, and OUT/lamps.json, where the lamps are."""
    rng, rig, room = np.random.default_rng(seed), rig_of(RIGS[cameras]), kept_room(seed)
    still = maps_of(room, rig, rng)
    write_rig(out, rig, [[noisy(each, rng) for each in still] for _ in range(frames)])
    lamps = [{"at": lamp.at.tolist(), "intensity": lamp.intensity_to(rig.centre).tolist()} for lamp in room.lamps]
    (out / "lamps.json").write_bytes(msgspec.json.encode(lamps))
    for lamp in lamps:
        print(
            "lamp at", "{:6.2f} {:6.2f} {:6.2f} m".format(*lamp["at"]), " intensity", "{:.2f} {:.2f} {:.2f} W/sr".format(*lamp["intensity"])
        )


def view(rig: CameraRig, k: int, points: list[dict]) -> np.ndarray:
    """The first frame of camera k as it sees it, zenith in the middle and its +x to the right, with a ring around each point."""
    given = {"source": rig.camera[k].source, "coverage": "hemisphere", "rows": 90}
    frame = open_source(section_from_options(settings.Capture, given)).frame(0)
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) * 2 / SIZE - 1
    theta = np.minimum(np.hypot(x, y) * np.pi / 2, np.pi / 2 - 1e-6)
    rows, cols, _ = frame.radiance.shape
    row, col = cell_from_direction(direction_from_angles(theta, np.arctan2(-y, x)).reshape(-1, 3), rows, cols, "hemisphere")
    light = frame.radiance[row.astype(int), col.astype(int) % cols].reshape(SIZE, SIZE, 3)
    light = light / np.quantile(light, WHITE)
    pixels = (255 * (light / (1 + light)) ** (1 / 2.2)).astype(np.uint8)
    pixels[np.hypot(x, y) > 1] = 24
    for point in points:
        away = (np.array(point["at"]) - rig.camera[k].at) @ rig.camera[k].world_from_camera
        distance = float(np.linalg.norm(away))
        if away[2] <= 0:
            continue
        reach = np.arccos(away[2] / distance) / (np.pi / 2) / max(np.hypot(away[0], away[1]), 1e-9)
        at = (int((1 + away[0] * reach) * SIZE / 2), int((1 - away[1] * reach) * SIZE / 2))
        cv2.circle(pixels, at, RING, INK, 1, cv2.LINE_AA)
        text = f"{point['id']}: {distance:.2f} m"
        start = at[0] + (-RING - TEXT if at[0] > SIZE - TEXT - RING else RING + 3), at[1] + 4
        for width, ink in ((3, (0, 0, 0)), (1, INK)):
            cv2.putText(pixels, text, start, cv2.FONT_HERSHEY_SIMPLEX, 0.42, ink, width, cv2.LINE_AA)
    return np.pad(pixels, ((RIM, RIM), (RIM, RIM), (0, 0)), constant_values=24)


def draw(out: Path, lights: Path, picture: Path) -> None:
    """The points of the last line over the views, and their errors."""
    rig, points = read_camera_rig(out / "rig.toml"), json.loads(lights.read_text().splitlines()[-1])["points"]
    lamps = json.loads((out / "lamps.json").read_text())
    for point in points:
        off = [float(np.linalg.norm(np.subtract(lamp["at"], point["at"]))) for lamp in lamps]
        n = int(np.argmin(off))
        ratio = np.sum(point["intensity"]) / np.sum(lamps[n]["intensity"])
        print(f"{point['id']}: {1e3 * off[n]:.0f} mm from lamp {n}, sigma {1e3 * point['sigma']:.0f} mm, {ratio:.3f} of its intensity")
    write_png(picture, np.concatenate([view(rig, k, points) for k in range(len(rig.camera))], axis=1))
    print(picture)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--cameras", type=int, choices=sorted(RIGS), default=3)
    parser.add_argument("--frames", type=int, default=8)
    parser.add_argument("--draw", type=Path, metavar="LIGHTS.jsonl")
    parser.add_argument("--picture", type=Path)
    options = parser.parse_args()
    if options.draw:
        draw(options.out, options.draw, options.picture or options.out / "located.png")
    else:
        record(options.out, options.seed, options.cameras, options.frames)


if __name__ == "__main__":
    main()
