"""Photographs of a calibration board by fisheye cameras at known poses."""

import numpy as np

from vemlight.capture.lens import Lens, direction_from_pixel

LENS = Lens(size=(560, 560), f=(175.0, 175.0), c=(279.5, 279.5), k1=-0.01, k2=0.0, k3=0.0, k4=0.0, rim_deg=90.0)
SAMPLES = 3  # of a pixel, along a side
BLACK, WHITE, ROOM = 20.0, 230.0, 110.0  # codes


def board_photograph(
    turn: np.ndarray, at: np.ndarray, board_turn: np.ndarray, middle: np.ndarray, corners: tuple[int, int], square_m: float
) -> np.ndarray:
    """A chessboard of that many inner corners, with a margin of a square, before a gray room, (h, w) uint8.

    turn (3, 3), at (3,): the camera's pose in the world; board_turn (3, 3), middle (3,): the board's, of the middle of its corners.
    """
    width, height = LENS.size
    offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5
    x, y = (np.add.outer(np.arange(n), offsets).ravel() for n in (width, height))
    rays = direction_from_pixel(np.stack(np.meshgrid(x, y), -1), LENS) @ (turn @ LENS.rotation).T
    off, along = (middle - at) @ board_turn[:, 2], rays @ board_turn[:, 2]
    hit = at + rays * (off / np.where(np.abs(along) < 1e-6, 1e-6, along))[..., None] - middle
    count = np.array(corners)
    squares = hit @ board_turn[:, :2] / square_m + (count - 1) / 2 + 1  # the first square begins at 0
    inside = (off / along > 0) & (squares > -1).all(axis=-1) & (squares < count + 2).all(axis=-1)
    on_board = (squares >= 0).all(axis=-1) & (squares < count + 1).all(axis=-1)
    dark = on_board & (np.floor(squares).sum(axis=-1) % 2 == 0)
    levels = np.where(inside, np.where(dark, BLACK, WHITE), ROOM)
    return levels.reshape(height, SAMPLES, width, SAMPLES).mean(axis=(1, 3)).round().astype(np.uint8)
