"""The lens found from photographs of a board."""

import json
import os
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from vemlight.capture.calibration.boards import BoardView, BoardViews, CalibrationBoard, find_board
from vemlight.capture.calibration.lens_calibration import calibrate_lens, lens_summary
from vemlight.capture.calibration.lens_fit import fit_lens
from vemlight.capture.lens import Lens, direction_from_pixel, pixel_angles, pixel_from_direction, read_lens
from vemlight.errors import UserError
from vemlight.light.sphere import direction_from_angles, rotation_xyz

BOARD = CalibrationBoard((8, 6), 0.03)
NARROW = Lens(size=(640, 480), f=(420.0, 421.0), c=(325.0, 236.0), k1=0.04, k2=-0.01, k3=0.0, k4=0.0, rim_deg=52.0)
FISHEYE = Lens(size=(800, 600), f=(176.0, 176.4), c=(411.0, 291.0), k1=-0.01, k2=0.003, k3=-0.001, k4=0.0, rim_deg=95.0)
WIDE = Lens(size=(700, 700), f=(165.0, 165.0), c=(340.0, 356.0), k1=0.02, k2=-0.008, k3=0.0, k4=0.0, rim_deg=118.0)
# 2 sin(theta / 2), whose first two terms are k1 = -1/24 and k2 = 1/1920
SOLID = Lens(size=(800, 800), f=(240.0, 240.0), c=(405.0, 396.0), k1=-1 / 24, k2=1 / 1920, k3=-1 / 322560, k4=0.0, rim_deg=95.0)


def board_points() -> np.ndarray:
    cols, rows = BOARD.corners
    return np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), -1).reshape(-1, 2) * BOARD.square_m


def poses(lens: Lens, count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Boards all around, turned at random, whole inside the lens's rim and image."""
    rng = np.random.default_rng(seed)
    points = board_points() - board_points().mean(0)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    while len(found) < count:
        theta, phi = np.radians(lens.rim_deg) * np.sqrt(rng.uniform(0, 1)), rng.uniform(0, 2 * np.pi)
        towards = direction_from_angles(theta, phi)
        x = np.cross([0.3, 1.0, 0.2], towards)
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(towards, x), towards], 1) @ rotation_xyz(tuple(rng.uniform(-35, 35, 3)))
        centre = towards * rng.uniform(0.15, 0.3)
        seen = np.column_stack([points, np.zeros(len(points))]) @ rotation.T + centre
        pixels = pixel_from_direction(seen, lens)
        inside = np.all((pixels > 8) & (pixels < np.array(lens.size) - 9))
        off = np.arctan2(np.hypot(seen[:, 0], seen[:, 1]), seen[:, 2])
        if inside and off.max() < lens.rim:
            found.append((rotation, centre))
    return found


def corner_views(lens: Lens, count: int, seed: int, noise_px: float) -> list[BoardView]:
    rng = np.random.default_rng(seed + 1)
    points = board_points()
    views = []
    for n, (rotation, centre) in enumerate(poses(lens, count, seed)):
        seen = np.column_stack([points - points.mean(0), np.zeros(len(points))]) @ rotation.T + centre
        views.append(BoardView(f"v{n}", pixel_from_direction(seen, lens) + rng.normal(0, noise_px, points.shape), points))
    return views


def disagreement_px(a: Lens, b: Lens, upto_deg: float) -> float:
    """Largest distance of the pixels that two lenses give the same ray."""
    theta, phi = np.meshgrid(np.radians(np.linspace(0, upto_deg, 30)), np.linspace(0, 2 * np.pi, 36))
    rays = direction_from_angles(theta, phi)
    return float(np.linalg.norm(pixel_from_direction(rays, a) - pixel_from_direction(rays, b), axis=-1).max())


@pytest.mark.parametrize("lens", [NARROW, FISHEYE, WIDE], ids=["narrow", "fisheye", "beyond-180"])
def test_lens_comes_back(lens: Lens) -> None:
    report = fit_lens(corner_views(lens, 14, 3, noise_px=0.1), lens.size)
    # 0.1 px in x and in y make 0.14 px of distance
    assert report.rms_px == pytest.approx(0.14, rel=0.15)
    assert not report.rejected
    assert report.reach_deg > 0.8 * lens.rim_deg
    # 14 views of 48 corners: the lens is known better than one corner, and nowhere worse than 0.5 px
    assert disagreement_px(report.lens, lens, report.reach_deg) < 0.5
    assert abs(report.lens.f[0] - lens.f[0]) < 5 * report.sigma["fx"]
    assert abs(report.lens.c[1] - lens.c[1]) < 5 * report.sigma["cy"]


LENS_TERMS = [(NARROW, 2), (FISHEYE, 3), (WIDE, 2), (SOLID, 2)]


@pytest.mark.parametrize(("lens", "terms"), LENS_TERMS, ids=["narrow", "fisheye", "beyond-180", "equisolid"])
def test_the_polynomial_has_the_terms_that_the_lens_needs(lens: Lens, terms: int) -> None:
    found = fit_lens(corner_views(lens, 14, 21, noise_px=0.1), lens.size).lens
    assert np.count_nonzero(found.k) == terms


@pytest.mark.parametrize(("noise_px", "terms"), [(0.15, 2), (0.2, 1)])  # the second term gains 1.8 and 1.1 % of the RMS
def test_a_term_must_gain_more_than_a_hundredth_of_the_rms(noise_px: float, terms: int) -> None:
    found = fit_lens(corner_views(SOLID, 14, 21, noise_px), SOLID.size).lens
    assert np.count_nonzero(found.k) == terms


def test_deviations_are_those_of_repeated_calibrations() -> None:
    reports = [fit_lens(corner_views(FISHEYE, 8, seed, noise_px=0.1), FISHEYE.size) for seed in range(8)]
    for name, error in {"fx": [r.lens.f[0] - FISHEYE.f[0] for r in reports], "cx": [r.lens.c[0] - FISHEYE.c[0] for r in reports]}.items():
        # chi-square of 8 values: within a factor of two of the deviation but once in a hundred times
        assert 0.5 < np.sqrt(np.mean(np.square(error))) / np.mean([r.sigma[name] for r in reports]) < 2


def test_exact_corners_give_the_exact_lens() -> None:
    report = fit_lens(corner_views(FISHEYE, 10, 1, noise_px=0.0), FISHEYE.size)
    assert disagreement_px(report.lens, FISHEYE, 80) < 0.02


def test_bad_view_is_left_out_and_named() -> None:
    views = corner_views(FISHEYE, 10, 5, noise_px=0.1)
    views[4] = views[4]._replace(pixels=views[4].pixels + np.random.default_rng(0).normal(0, 4, (48, 2)))
    report = fit_lens(views, FISHEYE.size)
    assert list(report.rejected) == ["v4"]
    assert "v4: left out" in lens_summary(report)
    assert report.rejected["v4"] > 3
    assert set(report.views) == {f"v{n}" for n in range(10)} - {"v4"}
    assert disagreement_px(report.lens, FISHEYE, 80) < 0.5


@pytest.mark.parametrize(
    ("noise_px", "own_noise_px", "left_out"),
    [
        (0.5, 0.75, False),  # 1.8 times as noisy as the others
        (0.5, 1.9, True),  # 4 times
        (0.1, 0.36, False),  # 4 times, but still 0.4 px only
        (0.1, 0.5, True),  # 0.7 px
    ],
)
def test_a_view_is_left_out_by_its_error_relative_to_the_others(noise_px: float, own_noise_px: float, left_out: bool) -> None:
    views = corner_views(FISHEYE, 12, 5, noise_px)
    views[4] = views[4]._replace(pixels=views[4].pixels + np.random.default_rng(1).normal(0, own_noise_px, (48, 2)))
    assert list(fit_lens(views, FISHEYE.size).rejected) == ["v4"] * left_out


@pytest.mark.parametrize(("shift_px", "outliers"), [(0.4, 1), (0.75, 10), (15.0, 10)])
def test_single_outliers_are_left_out(shift_px: float, outliers: int) -> None:
    views = corner_views(FISHEYE, 14, 6, noise_px=0.1)  # the median distance is 0.12 px, and 6 of them 0.7 px
    for n in range(10):
        views[n].pixels[n] += shift_px  # in x and in y
    report = fit_lens(views, FISHEYE.size)
    assert report.outliers == pytest.approx(outliers, abs=1)
    assert disagreement_px(report.lens, FISHEYE, 80) < 0.5


def render(lens: Lens, rotation: np.ndarray, centre: np.ndarray, pattern: np.ndarray, extent: tuple[float, float]) -> np.ndarray:
    """Photograph (height, width) uint8 of a flat picture of `extent` m whose middle lies at `centre`: 2 x 2 rays a pixel."""
    width, height = lens.size
    total = np.zeros((height, width))
    for v in (-0.25, 0.25):
        for u in (-0.25, 0.25):
            rays = direction_from_pixel(np.stack(np.meshgrid(np.arange(width) + u, np.arange(height) + v), -1), lens)
            along = (centre @ rotation[:, 2]) / (rays @ rotation[:, 2])
            local = (rays * along[..., None] - centre) @ rotation[:, :2]
            at = (local / np.array(extent) + 0.5) * np.array(pattern.shape[::-1])
            inside = (along > 0) & np.all((at >= 0) & (at < np.array(pattern.shape[::-1])), axis=-1)
            x, y = np.where(inside[..., None], at, 0).astype(int).transpose(2, 0, 1)
            total += np.where(inside, pattern[y, x], 90)
    return np.where(pixel_angles(lens) <= lens.rim, total / 4, 0).astype(np.uint8)


def chessboard() -> tuple[np.ndarray, tuple[float, float]]:
    cols, rows = BOARD.corners
    squares = (np.add.outer(np.arange(rows + 3), np.arange(cols + 3)) % 2).astype(np.uint8)
    squares[[0, -1]], squares[:, [0, -1]] = 1, 1
    return np.kron(squares, np.ones((20, 20), np.uint8)) * 200 + 20, ((cols + 3) * BOARD.square_m, (rows + 3) * BOARD.square_m)


def test_photographs_to_lens_file(tmp_path: Path) -> None:
    lens = msgspec.structs.replace(WIDE, size=(560, 560), f=(125.0, 125.0), c=(277.0, 283.0))
    pattern, extent = chessboard()
    paths = []
    for n, (rotation, centre) in enumerate(poses(lens, 8, 11)):
        paths.append(tmp_path / f"{n}.png")
        cv2.imwrite(str(paths[-1]), render(lens, rotation, centre, pattern, extent))
    report = calibrate_lens(paths, BOARD, tmp_path / "lens.toml", picture=tmp_path / "coverage.png")
    assert len(report.views) >= 5
    assert report.rms_px < 0.4
    assert report.reach_deg > 91
    assert disagreement_px(report.lens, lens, 88) < 1.0
    # the image circle's edge is seen: the rim is found to two degrees
    assert report.lens.rim_deg == pytest.approx(lens.rim_deg, abs=2.5)
    assert read_lens(tmp_path / "lens.toml") == report.lens
    picture = cv2.imread(str(tmp_path / "coverage.png"))
    assert picture is not None
    assert picture.shape == (560, 560, 3)


def test_a_lens_that_fits_badly_is_refused_unless_accepted(tmp_path: Path, monkeypatch) -> None:
    views = [v._replace(points=v.points * [1.3, 1.0]) for v in corner_views(WIDE, 8, 3, 0.1)]  # squares that are none
    brightest = np.full(WIDE.size[::-1], 255, np.uint8)
    monkeypatch.setattr("vemlight.capture.calibration.lens_calibration.read_views", lambda *_: BoardViews(views, [], brightest))
    with pytest.raises(UserError, match=r"fits the corners to .* px only.* 8 x 6 inner corners, or --accept it"):
        calibrate_lens([], BOARD, tmp_path / "lens.toml")
    assert not (tmp_path / "lens.toml").exists()
    assert calibrate_lens([], BOARD, tmp_path / "lens.toml", accept=True).rms_px > 3e-3 * max(WIDE.size)


def test_charuco_board_is_found_when_part_of_it_is_hidden() -> None:
    board = CalibrationBoard((7, 5), 0.03, "DICT_4X4_50", 0.022)
    drawn = cv2.aruco.CharucoBoard((8, 6), 0.03, 0.022, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    picture = cv2.copyMakeBorder(drawn.generateImage((640, 480)), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    picture[:, :160] = 255
    view = find_board("c", picture, board)
    assert view is not None
    assert 8 <= len(view.pixels) < 35
    # squares are 80 px and the first inner corner lies a square from the board's corner at 40 px; pixel centres are whole numbers
    np.testing.assert_allclose(view.pixels, view.points / 0.03 * 80 + 119.5, atol=0.3)


def write_blurred(folder: Path, count: int, size: int = 240) -> list[Path]:
    paths = [folder / f"{n}.png" for n in range(count)]
    for path in paths:
        cv2.imwrite(str(path), np.full((size, size), 120, np.uint8))
    return paths


def test_no_board_in_any_image(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"and 1 more: no board of 8x6 inner corners was found"):
        calibrate_lens(write_blurred(tmp_path, 2), BOARD, tmp_path / "lens.toml")
    assert not (tmp_path / "lens.toml").exists()


def test_too_few_views() -> None:
    views = corner_views(FISHEYE, 2, 1, 0.1)
    with pytest.raises(UserError, match="only 2 usable views of the board and 3 are needed; take more, sharp"):
        fit_lens(views, FISHEYE.size)
    with pytest.raises(UserError, match=r"none was found in a\.png, b\.png, c\.png \.\.: check --board"):
        fit_lens(views, FISHEYE.size, ["a.png", "b.png", "c.png", "d.png"])


@pytest.mark.parametrize(
    ("lens", "count", "noise_px", "fraction"),
    [
        (msgspec.structs.replace(FISHEYE, c=(300.0, 371.0)), 14, 0.1, 1.0),  # the axis far from the image's middle
        (FISHEYE, 4, 0.1, 1.0),
        (WIDE, 20, 0.5, 1.0),
        (WIDE, 14, 0.1, 0.4),  # as ChArUco boards that are seen in part
        (SOLID, 14, 0.1, 1.0),
    ],
    ids=["decentred", "few", "noisy", "in-part", "equisolid"],
)
def test_lens_comes_back_from_poor_sets(lens: Lens, count: int, noise_px: float, fraction: float) -> None:
    rng, views = np.random.default_rng(9), corner_views(lens, count, 21, noise_px)
    for n, view in enumerate(views):
        used = np.sort(rng.permutation(48)[: max(8, round(48 * fraction * rng.uniform(0.5, 1)))]) if fraction < 1 else np.arange(48)
        views[n] = BoardView(view.name, view.pixels[used], view.points[used])
    report = fit_lens(views, lens.size)
    assert report.rms_px < 1.6 * noise_px
    assert not report.rejected
    # where corners are: 1 px at a tenth of a pixel of noise, and more with more of it
    assert disagreement_px(report.lens, lens, report.reach_deg) < max(1.0, 3 * noise_px)


def test_two_sizes(tmp_path: Path) -> None:
    paths = write_blurred(tmp_path, 1)
    (tmp_path / "b").mkdir()
    paths += write_blurred(tmp_path / "b", 1, 200)
    with pytest.raises(UserError, match="200x200 and the images before it 240x240"):
        calibrate_lens(paths, BOARD, tmp_path / "lens.toml")


def test_file_that_is_no_image(tmp_path: Path) -> None:
    (tmp_path / "x.png").write_bytes(b"no image")
    with pytest.raises(UserError, match=r"x\.png: is not a readable image"):
        calibrate_lens([tmp_path / "x.png"], BOARD, tmp_path / "lens.toml")


@pytest.mark.parametrize(
    ("board", "word"),
    [
        (CalibrationBoard((2, 6), 0.03), "--board 2x6: no such board"),
        (CalibrationBoard((8, 101), 0.03), "--board 8x101: no such board"),
        (CalibrationBoard((8, 6), 0.0), "squares"),
        (CalibrationBoard((8, 6), 0.9e-4), "squares"),
        (CalibrationBoard((8, 6), 101.0), "squares"),
        (CalibrationBoard((8, 6), 0.03, "DICT_9", 0.02), "DICT_9"),
        (CalibrationBoard((8, 6), 0.03, "DICT_4X4_50", 0.04), "--marker 0.04"),
    ],
)
def test_impossible_boards(tmp_path: Path, board: CalibrationBoard, word: str) -> None:
    with pytest.raises(UserError, match=word):
        calibrate_lens(write_blurred(tmp_path, 1), board, tmp_path / "lens.toml")


def test_real_photographs(tmp_path: Path) -> None:
    data = os.environ.get("VEMLIGHT_DATA")
    if not data:
        pytest.skip("VEMLIGHT_DATA names no folder of real photographs")
    paths = sorted((Path(data) / "fisheye" / "fish_1").glob("*.jpg"))
    report = calibrate_lens(paths, CalibrationBoard((6, 8), 0.0325), tmp_path / "lens.toml")
    assert report.rms_px <= 0.60
    assert len(report.views) >= 14
    # the calibration published beside them, in OCamCalib's model: a ray is (u, v, polynomial(radius))
    published = json.loads((Path(data) / "fisheye" / "fish_1" / "published_ocam.json").read_text())
    radius = np.linspace(0, 520, 2000)
    angle = np.arctan2(radius, np.polynomial.polynomial.polyval(radius, published["taylor_coefficient"]))
    theta, phi = np.meshgrid(np.radians(np.linspace(1, 80, 40)), np.linspace(0, 2 * np.pi, 36))
    flat = np.interp(theta, angle, radius)[..., None] * np.stack([np.cos(phi), np.sin(phi)], -1)
    truth = flat @ np.array(published["stretch_matrix"]).T + published["distortion_center"]
    assert np.linalg.norm(pixel_from_direction(direction_from_angles(theta, phi), report.lens) - truth, axis=-1).max() < 1.0


@pytest.mark.parametrize("board", [CalibrationBoard((3, 100), 1e-4), CalibrationBoard((100, 3), 100.0)])
def test_boards_at_the_limits_are_looked_for(tmp_path: Path, board: CalibrationBoard) -> None:
    with pytest.raises(UserError, match=r"no board of .* was found"):  # the board itself is not refused
        calibrate_lens(write_blurred(tmp_path, 1), board, tmp_path / "lens.toml")
