"""Cube maps of three by two square faces in one image, resampled to the polar map with their power.

Faces from the left: right, left, up above down, front, back (FFmpeg's v360 calls it c3x2). Front is +X, left +Y, up +Z; the lower edge of
up and the upper edge of down touch front.
"""

import math

import numpy as np

from vemlight.capture.fisheye import Contributions, FisheyeToPolar, weights_from_contributions
from vemlight.capture.pixel_overlap import balance
from vemlight.kernels import kernel, subroutine
from vemlight.light.sphere import SPAN, Coverage, cell_solid_angles

COLUMNS, ROWS = 3, 2
# Of each face: the direction of its middle, of the image's right, of the image's down.
FACES = np.array([
    [[0, -1, 0], [-1, 0, 0], [0, 0, -1]],  # right
    [[0, 1, 0], [1, 0, 0], [0, 0, -1]],  # left
    [[0, 0, 1], [0, -1, 0], [1, 0, 0]],  # up
    [[0, 0, -1], [0, -1, 0], [-1, 0, 0]],  # down
    [[1, 0, 0], [0, -1, 0], [0, 0, -1]],  # front
    [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],  # back
], np.float64)  # fmt: skip
FEWEST_PARTS, MOST_PARTS = 4, 64  # of a pixel along a side, each of which goes to one cell: direction is then right to 0.002 degrees
PARTS_OF_CELL = 3  # a part is at most a third of a cell wide: none between the pixels of a small map, or at the pole, is left empty


def is_cube(width: int, height: int) -> bool:
    """Whether an image has room for three by two square faces."""
    return width * ROWS == height * COLUMNS and width % COLUMNS == 0


def cube_directions(pixel: np.ndarray, side: int) -> np.ndarray:
    """Unit vectors (m, 3) in the world of pixel coordinates (m, 2), x and y, of an image whose faces have `side` pixels."""
    column, row = np.clip((pixel[:, 0] + 0.5) // side, 0, COLUMNS - 1), np.clip((pixel[:, 1] + 0.5) // side, 0, ROWS - 1)
    faces = FACES[(row * COLUMNS + column).astype(int)]
    u = 2 * (pixel[:, 0] + 0.5 - column * side) / side - 1
    v = 2 * (pixel[:, 1] + 0.5 - row * side) / side - 1
    directions = faces[:, 0] + u[:, None] * faces[:, 1] + v[:, None] * faces[:, 2]
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def cube_to_polar(side: int, rows: int, cols: int, coverage: Coverage) -> FisheyeToPolar:
    """Weights from images of six faces of `side` pixels to the polar map.

    A pixel's parts are even on its face; each counts with its own solid angle, (2 / side)^2 (1 + u^2 + v^2)^-1.5.
    """
    cell_solid = np.repeat(cell_solid_angles(rows, cols, coverage), cols)
    contributions = [_contributions(face, number, side, rows, cols, float(SPAN[coverage])) for number, face in enumerate(FACES)]
    pixel, cell, solid = map(np.concatenate, zip(*contributions, strict=True))
    balance(pixel, cell, solid, cell_solid)
    return weights_from_contributions((ROWS * side, COLUMNS * side), rows, cols, Contributions(pixel, cell, solid / cell_solid[cell]))


@kernel
def _contributions(face, number, side, rows, cols, span):
    """Pixels (n,), cells (n,) and their common solid angles (n,) of one face."""
    most = MOST_PARTS * MOST_PARTS
    cells, solids = np.empty(most, np.int64), np.empty(most)
    pixel, cell, solid = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    above, below = np.empty(side + 1, np.int64), np.empty(side + 1, np.int64)  # cells of the corners of a row of pixels
    _corners(below, face, 0, side, rows, cols, span)
    count = 0
    for y in range(side):
        above, below = below, above
        _corners(below, face, y + 1, side, rows, cols, span)
        for x in range(side):
            # on the first ring a pixel may hold the pole, whose corners say nothing of what lies between
            whole = above[x] >= cols and above[x] == above[x + 1] == below[x] == below[x + 1]
            if above[x] < 0 and above[x + 1] < 0 and below[x] < 0 and below[x + 1] < 0:
                continue
            if count + most > len(pixel):
                pixel, cell, solid = _doubled(pixel, most), _doubled(cell, most), _doubled(solid, most)
            found = _parts_of_pixel(cells, solids, face, x, y, side, whole, rows, cols, span)
            for n in range(found):
                pixel[count] = (number // 3 * side + y) * 3 * side + number % 3 * side + x
                cell[count], solid[count] = cells[n], solids[n]
                count += 1
    return pixel[:count], cell[:count], solid[:count]


@subroutine
def _corners(cells, face, y, side, rows, cols, span):
    for x in range(side + 1):
        cells[x] = _cell(face, 2 * x / side - 1, 2 * y / side - 1, rows, cols, span)


@subroutine
def _doubled(values, more):
    longer = np.empty(2 * len(values) + more, values.dtype)
    for n in range(len(values)):
        longer[n] = values[n]
    return longer


@subroutine
def _parts_of_pixel(cells, solids, face, x, y, side, whole, rows, cols, span):
    """Writes the cells that the pixel's parts lie in and their solid angles; returns how many cells there are."""
    parts = 1 if whole else _parts(face, 2 * (x + 0.5) / side - 1, 2 * (y + 0.5) / side - 1, 2 / side, rows, cols, span)
    found = 0
    for part in range(parts * parts):
        u = 2 * (x + (part % parts + 0.5) / parts) / side - 1
        v = 2 * (y + (part // parts + 0.5) / parts) / side - 1
        at = _cell(face, u, v, rows, cols, span)
        if at < 0:
            continue
        solid = (2 / side / parts) ** 2 * (1 + u * u + v * v) ** -1.5
        n = 0
        while n < found and cells[n] != at:
            n += 1
        if n == found:
            cells[n], solids[n] = at, 0.0
            found += 1
        solids[n] += solid
    return found


@subroutine
def _parts(face, u, v, pixel_side, rows, cols, span):
    """Into how many parts along a side a pixel is divided, by the narrowest cell near it."""
    x, y, z = _direction(face, u, v)
    sine = math.hypot(x, y) / math.sqrt(x * x + y * y + z * z)
    narrowest = min(span / rows, 2 * math.pi / cols * max(sine - 1.5 * pixel_side, 1e-9))
    return min(max(FEWEST_PARTS, math.ceil(PARTS_OF_CELL * pixel_side / narrowest)), MOST_PARTS)


@subroutine
def _direction(face, u, v):
    return (
        face[0, 0] + u * face[1, 0] + v * face[2, 0],
        face[0, 1] + u * face[1, 1] + v * face[2, 1],
        face[0, 2] + u * face[1, 2] + v * face[2, 2],
    )


@subroutine
def _cell(face, u, v, rows, cols, span):
    """The flat index of the cell at u, v of a face; -1 outside the map."""
    x, y, z = _direction(face, u, v)
    row = int(math.atan2(math.hypot(x, y), z) * rows / span)
    if row >= rows:
        return -1
    col = int(math.atan2(y, x) / (2 * math.pi) % 1.0 * cols)
    return row * cols + min(col, cols - 1)
