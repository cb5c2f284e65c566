"""Calibration boards in photographs: the corners of chessboards and ChArUco boards, to a fraction of a pixel."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from vemlight.errors import UserError
from vemlight.light.images import read_photograph
from vemlight.runtime.progress import counted
from vemlight.toml import choice_hint

QUICK = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ADAPTIVE_THRESH
THOROUGH = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
# Larger photographs are searched in a smaller copy: OpenCV's search takes minutes for twelve megapixels without a board, and squares of the
# largest board that is allowed are 20 pixels here. Corners are refined in the photograph itself; 1500 to 3000 would do.
SEARCH_PX = 2000
MIN_CHARUCO_CORNERS = 8  # in a view: a pose takes 4, and twice that is needed to notice a wrong one; 6 to 12 do
MIN_CORNERS, MAX_CORNERS = 3, 100  # on a side: OpenCV finds no chessboard with fewer than 3; more than 100 would be under 10 px apart
MIN_SQUARE_M, MAX_SQUARE_M = 1e-4, 100  # a tenth of a millimetre and a stadium: beyond, another unit was meant
# cornerSubPix looks this far around a corner, as a fraction of the spacing of corners: beyond half a square it would see the edges of
# neighbouring ones. In pixels it stays between what a gradient needs and what gains nothing more.
WINDOW_FRACTION = 0.35
MIN_WINDOW_PX, MAX_WINDOW_PX = 2, 8


class CalibrationBoard(NamedTuple):
    """A flat board of squares."""

    corners: tuple[int, int]  # inner corners, columns and rows
    square_m: float
    dictionary: str = ""  # ChArUco: OpenCV's name of the marker dictionary, such as DICT_4X4_50; empty: a chessboard
    marker_m: float = 0.0  # ChArUco: side of a marker


class BoardView(NamedTuple):
    """The corners found in one photograph."""

    name: str
    pixels: np.ndarray  # (n, 2) float64, x and y
    points: np.ndarray  # (n, 2) float64, their positions on the board in m


class BoardViews(NamedTuple):
    """What a set of photographs shows."""

    views: list[BoardView]
    without_board: list[str]  # names of the photographs in which no board was found
    brightest: np.ndarray  # (height, width) uint8, the highest value of each pixel in all photographs

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the photographs."""
        return self.brightest.shape[1], self.brightest.shape[0]


def read_views(paths: list[Path], board: CalibrationBoard) -> BoardViews:
    """Finds the board in each photograph.

    Raises UserError for a file that is no image, for images of different sizes, and when no image shows the board.
    """
    check_board(board)
    views, without_board, brightest = [], [], None
    for path in counted(paths, "photographs", len(paths)):
        image = read_photograph(path)
        if brightest is None:
            brightest = image
        if image.shape != brightest.shape:
            size, first = f"{image.shape[1]}x{image.shape[0]}", f"{brightest.shape[1]}x{brightest.shape[0]}"
            raise UserError(f"{path}: is {size} and the images before it {first}; calibrate with images of one size")
        brightest = np.maximum(brightest, image)
        view = find_board(path.name, image, board)
        if view:
            views.append(view)
        else:
            without_board.append(path.name)
    if not views or brightest is None:
        size = "x".join(map(str, board.corners))
        where = str(paths[0]) if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more"
        options = "--board, --dictionary" if board.dictionary else "--board"
        raise UserError(f"{where}: no board of {size} inner corners was found; check {options}, and that the photographs are sharp")
    return BoardViews(views, without_board, brightest)


def check_board(board: CalibrationBoard) -> None:
    """Raises UserError for an impossible board."""
    if min(board.corners) < MIN_CORNERS or max(board.corners) > MAX_CORNERS:
        size = f"{board.corners[0]}x{board.corners[1]}"
        raise UserError(f"--board {size}: no such board can be found; give its inner corners, {MIN_CORNERS} to {MAX_CORNERS} a side")
    if not MIN_SQUARE_M <= board.square_m <= MAX_SQUARE_M:
        raise UserError(f"--square {board.square_m:g}: squares of that many metres are not likely; give their side in metres")
    names = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
    if board.dictionary and board.dictionary not in names:
        raise UserError(f"--dictionary {board.dictionary}: OpenCV has none of that name; {choice_hint(board.dictionary, names)}")
    if board.dictionary and not board.marker_m:
        raise UserError("--marker: is missing; a ChArUco board takes the side of its markers in metres")
    if board.dictionary and not 0 < board.marker_m < board.square_m:
        limit = f"above 0 and below the --square of {board.square_m:g}"
        raise UserError(f"--marker {board.marker_m:g}: does not fit into the squares; give the side of a marker in metres, {limit}")


def find_board(name: str, image: np.ndarray, board: CalibrationBoard) -> BoardView | None:
    """The board in a gray image (height, width) uint8, or None."""
    return _find_charuco(name, image, board) if board.dictionary else _find_chessboard(name, image, board)


def _find_chessboard(name: str, image: np.ndarray, board: CalibrationBoard) -> BoardView | None:
    cols, rows = board.corners
    shrink = max(1.0, max(image.shape) / SEARCH_PX)
    height, width = (round(side / shrink) for side in image.shape)
    searched = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) if shrink > 1 else image
    found, pixels = cv2.findChessboardCorners(searched, (cols, rows), flags=QUICK)
    if not found:
        found, pixels = cv2.findChessboardCornersSB(searched, (cols, rows), flags=THOROUGH)
    if not found or pixels is None or pixels.size != 2 * cols * rows:
        return None
    grid = pixels.reshape(rows, cols, 2).astype(np.float64)
    if shrink > 1:
        grid = (grid + 0.5) * (np.array(image.shape[::-1]) / (width, height)) - 0.5
    spacing = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min()) for axis in (0, 1))
    points = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), -1).reshape(-1, 2) * board.square_m
    return BoardView(name, _refined(image, grid.reshape(-1, 2), spacing), points)


def _find_charuco(name: str, image: np.ndarray, board: CalibrationBoard) -> BoardView | None:
    cols, rows = board.corners
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    detector = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard((cols + 1, rows + 1), board.square_m, board.marker_m, dictionary))
    pixels, ids, _, _ = detector.detectBoard(image)
    if ids is None or len(ids) < MIN_CHARUCO_CORNERS:
        return None
    ids, pixels = ids.ravel(), pixels.reshape(-1, 2).astype(np.float64)
    # spacing of neighbours along the rows that were found
    pairs = [(a - 1, a) for a in range(1, len(ids)) if ids[a] - ids[a - 1] == 1 and ids[a] % cols]
    spacing = min((float(np.linalg.norm(pixels[b] - pixels[a])) for a, b in pairs), default=10.0)
    points = np.stack([ids % cols, ids // cols], -1) * board.square_m
    return BoardView(name, _refined(image, pixels, spacing), points)


def _refined(image: np.ndarray, pixels: np.ndarray, spacing: float) -> np.ndarray:
    half = int(np.clip(WINDOW_FRACTION * spacing, MIN_WINDOW_PX, MAX_WINDOW_PX))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-3)
    corners = np.ascontiguousarray(pixels, np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(image, corners, (half, half), (-1, -1), stop).reshape(-1, 2).astype(np.float64)
