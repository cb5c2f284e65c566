"""The picture of how a rig is calibrated: python -m bench.rig_steps_picture [--out docs/pictures/rig_steps.png]

Virtual cameras see a lamp that is carried around and a board that is held up; the poses are those that `vemlight calibrate rig` finds.
"""

import argparse
import tempfile
from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")
import msgspec
import numpy as np
from matplotlib import pyplot
from matplotlib.axes import Axes
from scipy.spatial.transform import Rotation

from tests.support.board_photographs import LENS, board_photograph
from tests.support.wand_recordings import rough_rig, write_wand
from vemlight.capture.calibration.boards import CalibrationBoard
from vemlight.capture.lens import write_lens
from vemlight.commands.camera_rig_calibration import Wand, calibrate_camera_rig, calibrate_camera_rig_by_board
from vemlight.fuse.rig_file import CameraRig, read_camera_rig
from vemlight.light.images import read_photograph, read_radiance

NAMES = ("left", "right", "back")
AT = np.array([[-0.5, 0.0, 1.0], [0.5, 0.0, 1.0], [0.0, 0.9, 1.1]])
TURNS = Rotation.from_euler("xyz", [[0, 0, 0], [8, -10, 40], [-12, 5, -60]], degrees=True).as_matrix()
WRONG_M = np.array([[0, 0, 0], [0.15, -0.1, 0], [-0.1, 0.15, 0.1]])  # of the file before
PLACES = 30
BOARD, SQUARE_M = (8, 5), 0.1
INK, OLD, LAMP = "#1f4e79", "#b9b9b9", "#d97a00"
COLOURS = ("#1f77b4", "#2c8c3c", "#b0422b")


def carried() -> np.ndarray:
    """Where the lamp is held: rounds at three heights, (PLACES, 3), m."""
    turn = np.linspace(0, 6.5 * np.pi, PLACES, endpoint=False)
    height, reach = np.repeat([1.5, 2.0, 2.5], PLACES // 3), np.tile(np.linspace(1.2, 2.6, PLACES // 3), 3)
    return np.column_stack([reach * np.cos(turn), 0.4 + reach * np.sin(turn), height])


def boards() -> list[tuple[np.ndarray, np.ndarray]]:
    """world_from_board and the middle of each of six."""
    rng = np.random.default_rng(2)
    middles = np.column_stack([rng.uniform(-0.5, 0.5, 6), rng.uniform(-0.1, 0.9, 6), rng.uniform(2.0, 2.4, 6)])
    tilts = np.column_stack([180 + rng.uniform(-25, 25, 6), rng.uniform(-25, 25, 6), rng.uniform(-180, 180, 6)])
    return list(zip(Rotation.from_euler("xyz", tilts, degrees=True).as_matrix(), middles, strict=True))


def plan(axes: Axes, found: CameraRig, lamp: np.ndarray) -> None:
    """From above: where the lamp was held, where the file had the cameras, and where they were found."""
    axes.plot(*lamp[:, :2].T, color=LAMP, lw=0.6, alpha=0.6)
    axes.scatter(*lamp[:, :2].T, s=26, color=LAMP, zorder=3, label="the lamp, held still")
    for k, (name, old, camera) in enumerate(zip(NAMES, AT + WRONG_M, found.camera, strict=True)):
        axes.plot(*old[:2], "x", color=OLD, ms=9, mew=2, label="cameras, as guessed" if k == 0 else None)
        axes.plot(*camera.at[:2], "o", color=COLOURS[k], ms=9, label="cameras, as found" if k == 0 else None)
        axes.annotate(name, camera.at[:2], (8, 8), textcoords="offset points", color=COLOURS[k])
    axes.annotate("", found.camera[1].at[:2], found.camera[0].at[:2], arrowprops={"arrowstyle": "<->", "color": INK})
    axes.text(0, -0.12, "1.000 m, by tape", ha="center", va="top", color=INK, fontsize=8)
    axes.set(aspect="equal", title="from above, m: a lamp at thirty places", ylim=(-4, None))
    axes.legend(fontsize=7, loc="lower left")


def wand_row(row: list[Axes], folder: Path) -> None:
    lamp = carried()
    rig = write_wand(folder, TURNS, AT, lamp, rough_rig("lrb", AT + WRONG_M))
    calibrate_camera_rig(rig, Wand("l", "r", 1.0), "hemisphere")
    found = read_camera_rig(rig)
    plan(row[0], found, lamp)
    for k, (axes, camera) in enumerate(zip(row[1:], found.camera, strict=True)):
        brightest = np.max([read_radiance(path)[0][..., 0] for path in sorted(Path(camera.source).glob("*.exr"))], axis=0)
        grown = cv2.dilate(brightest, np.ones((3, 3)))  # a lamp of few pixels is lost in a small picture
        axes.imshow(np.clip(grown, 0, None) ** 0.2, cmap="gray")
        axes.set_title(f"{NAMES[k]}: all its frames", color=COLOURS[k])


def board_row(row: list[Axes], folder: Path) -> None:
    write_lens(folder / "lens.toml", LENS)
    held = boards()
    for k, name in enumerate(NAMES):
        (folder / "views" / name).mkdir(parents=True)
        for n, board in enumerate(held):
            cv2.imwrite(str(folder / "views" / name / f"{n}.png"), board_photograph(TURNS[k], AT[k], *board, BOARD, SQUARE_M))
    rough = rough_rig("lrb", AT + WRONG_M)
    cameras = [msgspec.structs.replace(c, name=n, source=n, lens="lens.toml") for c, n in zip(rough.camera, NAMES, strict=True)]
    (folder / "rig.toml").write_bytes(msgspec.toml.encode(CameraRig(camera=tuple(cameras))))
    calibrate_camera_rig_by_board(folder / "rig.toml", folder / "views", CalibrationBoard(BOARD, SQUARE_M))
    found = read_camera_rig(folder / "rig.toml")
    for k, camera in enumerate(found.camera):
        row[0].plot(*(AT + WRONG_M)[k, :2], "x", color=OLD, ms=9, mew=2)
        row[0].plot(*camera.at[:2], "o", color=COLOURS[k], ms=9)
        row[0].annotate(NAMES[k], camera.at[:2], (8, 8), textcoords="offset points", color=COLOURS[k])
    for turn, middle in held:
        half = np.array([(BOARD[0] + 1) / 2, (BOARD[1] + 1) / 2]) * SQUARE_M
        rim = middle + (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half) @ turn[:, :2].T
        row[0].plot(*rim[:, :2].T, color=LAMP, lw=1)
    row[0].set(aspect="equal", title="from above, m: a board at six places")
    for k, axes in enumerate(row[1:]):
        axes.imshow(read_photograph(folder / "views" / NAMES[k] / "1.png"), cmap="gray", vmin=0, vmax=255)
        axes.set_title(f"{NAMES[k]}: the second of six", color=COLOURS[k])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/pictures/rig_steps.png"))
    options = parser.parse_args()
    figure, rows = pyplot.subplots(2, 4, figsize=(13, 6.6), layout="constrained")
    with tempfile.TemporaryDirectory() as name:
        for part in ("wand", "board"):
            (Path(name) / part).mkdir()
        wand_row(list(rows[0]), Path(name) / "wand")
        board_row(list(rows[1]), Path(name) / "board")
    for axes in rows[:, 1:].ravel():
        axes.set_axis_off()
    figure.savefig(options.out, dpi=90)
    print(options.out)


if __name__ == "__main__":
    main()
