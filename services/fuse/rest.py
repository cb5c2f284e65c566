"""One map of several cameras' maps: each turned into the world by where its cells lie, and their mean.

No map is resampled: a camera's cell gives its light to the fused map's cells that it lies in, by solid angle, and a fused cell's radiance
is the light that it was given over the solid angle that was looked at. So a constant stays constant, power stays whole, and what no camera
sees is dark. Light of a bright cell goes to where it lies inside it.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.fuse.compact_sources import CompactSources
from vemlight.kernels import kernel, read_only
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells, bright_cells_from_light
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.sphere import SPAN, Coverage, cell_from_direction, cell_solid_angles, direction_from_angles, ring_edges

SUBDIVISION = 4  # on a side of a cell: its parts lie in three fused cells on average
BALANCING = 12  # rounds, after which constants and power are right to 1e-3
INNER = 0.7  # of a cell's solid angle: by parts an inner cell gets 0.8 to 1.2 of it
TINY = 1e-30
WHOLE = 0.95  # of a block of many cells: what is left is the coarseness of the cells at its edge
MIN_SEEN = 0.05  # of a fused cell that cameras must have looked at, for its radiance to be known
MIN_BELOW = 0.05  # of the lower half that cameras must see for the fused map to be of the sphere; a lens tilted by 9 degrees sees it
FULL_TURN = 2 * np.pi


class Layout(NamedTuple):
    """Rows, columns and coverage of a polar map."""

    rows: int
    cols: int
    coverage: Coverage


class CellsInWorld(NamedTuple):
    """The cells of a camera's map that lie in each fused cell, by rows of a sparse matrix.

    starts: (fused cells + 1,) int64. cells: (n,) int32, row * cols + column in the camera's map. solid_angles: (n,) float32, sr.
    looked_at: (fused cells,) float64, sr, their sums.
    """

    starts: np.ndarray
    cells: np.ndarray
    solid_angles: np.ndarray
    looked_at: np.ndarray


class CameraView(NamedTuple):
    """What a camera gives to the fused map. map: in the camera's axes. world_from_camera: (3, 3). gain: (3,). weight: in the mean."""

    map: EnvironmentMap
    world_from_camera: np.ndarray
    gain: np.ndarray
    weight: float


class FusedMap(NamedTuple):
    """map: in the world's axes. irradiance: (3,) float64, its integral. uncovered: fraction of it that no camera sees, which is dark."""

    map: EnvironmentMap
    irradiance: np.ndarray
    uncovered: float


def layout_of(radiance: np.ndarray, coverage: Coverage) -> Layout:
    """The layout of a polar map (rows, cols, 3)."""
    return Layout(radiance.shape[0], radiance.shape[1], coverage)


@lru_cache(maxsize=8)
def fused_layout(views: tuple[tuple[Layout, bytes], ...]) -> Layout:
    """The layout of the fused map of cameras with these maps and turns: as fine as the finest, the sphere if they see its lower half.

    Turns are the bytes of world_from_camera, (3, 3) float64.
    """
    pitch = min(SPAN[layout.coverage] / layout.rows for layout, _ in views)
    coverage = _coverage_of([(layout.coverage, np.frombuffer(turn).reshape(3, 3)) for layout, turn in views])
    return Layout(round(SPAN[coverage] / pitch), max(layout.cols for layout, _ in views), coverage)


def _coverage_of(views: Sequence[tuple[Coverage, np.ndarray]]) -> Coverage:
    """What maps of these coverages see together, turned by world_from_camera (3, 3) each."""
    if all(coverage == "hemisphere" and turn[2, 2] > 1 - 1e-9 for coverage, turn in views):
        return "hemisphere"
    below = direction_from_angles(np.pi / 2 + np.arcsin((np.arange(32) + 0.5) / 32)[:, None], np.arange(64)[None, :] * (FULL_TURN / 64))
    seen = np.zeros(below.shape[:2], bool)
    for coverage, turn in views:
        seen |= (coverage == "sphere") | ((below @ turn)[..., 2] > 0)
    return "sphere" if seen.mean() >= MIN_BELOW else "hemisphere"


def without_lights(seen: EnvironmentMap, sources: CompactSources, taken: np.ndarray) -> EnvironmentMap:
    """The map without a share (n, 3) of the light of each of its sources: all of it leaves what is behind the source."""
    if not taken.any():
        return seen
    rows, cols, _ = seen.radiance.shape
    radiance = _lessened(read_only(seen.radiance.reshape(-1, 3)), sources.owner, sources.background, taken)
    cells, directions, weights = seen.bright_cells
    owner = sources.owner[cells]
    stays = (owner < 0) | (taken[owner].min(axis=1) < 1)
    return seen._replace(
        radiance=radiance.reshape(rows, cols, 3), bright_cells=BrightCells(cells[stays], directions[stays], weights[stays])
    )


def fused(views: Sequence[CameraView], goal: Layout) -> FusedMap:
    """The weighted mean of the cameras' maps, cell by cell of those that see it, in the layout `goal`."""
    cells = goal.rows * goal.cols
    light, seen = np.zeros((cells, 3)), np.zeros(cells)
    bright: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for view in views:
        own = layout_of(view.map.radiance, view.map.coverage)
        places = cells_in_world(own, goal, np.ascontiguousarray(view.world_from_camera).tobytes())
        given = _valid_light(read_only(view.map.radiance.reshape(-1, 3)), view.gain * view.weight)
        given[view.map.bright_cells.cells] = 0
        _gather(given, places.starts, places.cells, places.solid_angles, light)
        seen += view.weight * places.looked_at
        if len(view.map.bright_cells.cells):
            bright.append(_bright_samples(view, own, goal, light))
    solid = _cell_solid(goal)
    radiance, irradiance, uncovered = _mean(light, seen, solid, MIN_SEEN * min(view.weight for view in views))
    samples = NO_BRIGHT_CELLS
    if bright:
        cells, directions, flux = (np.concatenate(parts) for parts in zip(*bright, strict=True))
        samples = bright_cells_from_light(cells, directions, flux, *goal)
    return FusedMap(EnvironmentMap(radiance.reshape(goal.rows, goal.cols, 3), goal.coverage, samples), irradiance, uncovered)


def block_radiance(seen: EnvironmentMap, world_from_camera: np.ndarray, blocks: Layout) -> np.ndarray:
    """The mean radiance (rows * cols, 3) of blocks of the world in a camera's map; nan where the camera sees a part of one or nothing."""
    own, count = layout_of(seen.radiance, seen.coverage), blocks.rows * blocks.cols
    light = np.zeros((count, 3))
    places = cells_in_world(own, blocks, np.ascontiguousarray(world_from_camera).tobytes())
    _gather(_valid_light(read_only(seen.radiance.reshape(-1, 3)), np.ones(3)), places.starts, places.cells, places.solid_angles, light)
    whole = places.looked_at > WHOLE * _cell_solid(blocks)
    return np.where(whole[:, None], light / np.maximum(places.looked_at, TINY)[:, None], np.nan)


def _bright_samples(view: CameraView, own: Layout, goal: Layout, light: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Adds the light of a map's bright cells to the fused cells `light` (cells, 3) where its samples lie. Returns those cells, the samples'
    directions in the world and their luminous flux.
    """
    cells, directions, weights = view.map.bright_cells
    turned = directions @ view.world_from_camera.T
    row, col = cell_from_direction(turned, *goal)
    inside = row < goal.rows
    if _is_same(own, goal, view.world_from_camera):  # rounding must not put a sample into the next cell
        goals, inside = cells, np.ones(len(cells), bool)
    else:
        goals = row.astype(np.int64) * goal.cols + col.astype(np.int64) % goal.cols
    solid = _cell_solid(own)[cells]
    radiance = view.map.radiance.reshape(-1, 3)[cells].astype(np.float64)
    flux = np.where(np.isfinite(radiance) & (radiance > 0), radiance, 0) * view.gain * (solid * weights * view.weight)[:, None]
    np.add.at(light, goals[inside], flux[inside])
    return goals[inside], turned[inside].astype(np.float32), luminance_from_rgb(flux[inside])


def _is_same(own: Layout, goal: Layout, world_from_camera: np.ndarray) -> bool:
    """Whether a map's cells are the fused map's."""
    return own == goal and bool(np.abs(world_from_camera - np.eye(3)).max() < 1e-12)


@lru_cache(maxsize=32)  # two runs of a rig of 16 cameras: 0.2 s and 2 MB each
def cells_in_world(own: Layout, goal: Layout, world_from_camera: bytes) -> CellsInWorld:
    """Where the cells of a camera's map lie in the fused map; world_from_camera: the bytes of a (3, 3) float64 array."""
    turn = np.frombuffer(world_from_camera).reshape(3, 3)
    count, goals = own.rows * own.cols, goal.rows * goal.cols
    if _is_same(own, goal, turn):
        solid_angles = _cell_solid(own).astype(np.float32)
        return CellsInWorld(np.arange(count + 1), np.arange(count, dtype=np.int32), solid_angles, solid_angles.astype(np.float64))
    # Parts of cells of equal solid angle, each in one fused cell.
    fine = Layout(own.rows * SUBDIVISION, own.cols * SUBDIVISION, own.coverage)
    cosines = 1 - ring_edges(fine.rows, fine.coverage)
    theta = np.arccos(np.clip((cosines[1:] + cosines[:-1]) / 2, -1, 1))
    phi = (np.arange(fine.cols) + 0.5) * (FULL_TURN / fine.cols)
    row, col = cell_from_direction(direction_from_angles(theta[:, None], phi[None, :]) @ turn.T, *goal)
    cell = (np.arange(fine.rows)[:, None] // SUBDIVISION) * own.cols + np.arange(fine.cols)[None, :] // SUBDIVISION
    solid = np.broadcast_to(cell_solid_angles(*fine)[:, None], row.shape)
    inside = row < goal.rows
    fused_cells = row[inside].astype(np.int64) * goal.cols + col[inside].astype(np.int64) % goal.cols
    pairs, place = np.unique(fused_cells * count + cell[inside], return_inverse=True)
    target, source = np.divmod(pairs, count)
    given = _balanced(source, target, np.bincount(place, solid[inside]), _cell_solid(own), _cell_solid(goal)).astype(np.float32)
    starts = np.searchsorted(target, np.arange(goals + 1))
    return CellsInWorld(starts, source.astype(np.int32), given, np.bincount(target, given, goals))


def _balanced(source: np.ndarray, target: np.ndarray, given: np.ndarray, own: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The solid angles `given` (n,) by cells `source` to cells `target`, so that both sums are the cells' own solid angles (Sinkhorn 1967).

    Cells that lie on the rim of the other map have a part only, and keep the sum that they have.
    """
    of_source, of_target = np.bincount(source, given, len(own)), np.bincount(target, given, len(goal))
    wanted_of_target = np.where(of_target > INNER * goal, goal, of_target)
    wanted_of_source = np.where(of_source > INNER * own, own, of_source)
    for _ in range(BALANCING):
        given = given * (wanted_of_target / np.maximum(np.bincount(target, given, len(goal)), TINY))[target]
        given = given * (wanted_of_source / np.maximum(np.bincount(source, given, len(own)), TINY))[source]
    return given


@lru_cache(maxsize=8)
def _cell_solid(layout: Layout) -> np.ndarray:
    """Solid angle of every cell, (cells,) sr."""
    return np.repeat(cell_solid_angles(*layout), layout.cols)


@kernel
def _valid_light(radiance, factor):
    # radiance (cells, 3) times a factor (3,); 0 where it is not finite or below 0
    light = np.empty((len(radiance), 3), np.float32)
    for cell in range(len(radiance)):
        for c in range(3):
            value = radiance[cell, c]
            light[cell, c] = value * factor[c] if 0 < value < np.inf else 0.0
    return light


@kernel
def _gather(given, starts, cells, solid_angles, light):
    # adds to fused cells (goals, 3) the light that a camera's cells (cells, 3) give them
    for goal in range(len(light)):
        red, green, blue = 0.0, 0.0, 0.0
        for n in range(starts[goal], starts[goal + 1]):
            cell, solid = cells[n], np.float64(solid_angles[n])
            red += given[cell, 0] * solid
            green += given[cell, 1] * solid
            blue += given[cell, 2] * solid
        light[goal, 0] += red
        light[goal, 1] += green
        light[goal, 2] += blue


@kernel
def _mean(light, seen, solid_angles, least):
    # radiance of fused cells (cells, 3), dark where less than `least` of a cell was looked at, its integral (3,), and how much is dark
    radiance, irradiance, dark, whole = np.zeros((len(light), 3), np.float32), np.zeros(3), 0.0, 0.0
    for cell in range(len(light)):
        solid = solid_angles[cell]
        whole += solid
        if seen[cell] > least * solid:
            for c in range(3):
                radiance[cell, c] = light[cell, c] / seen[cell]
                irradiance[c] += radiance[cell, c] * solid
        else:
            dark += solid
    return radiance, irradiance, dark / whole


@kernel
def _lessened(radiance, owner, background, taken):
    out = np.empty((len(radiance), 3), np.float32)
    for cell in range(len(radiance)):
        source = owner[cell]
        if source < 0:
            out[cell, 0], out[cell, 1], out[cell, 2] = radiance[cell, 0], radiance[cell, 1], radiance[cell, 2]
            continue
        for c in range(3):
            light = radiance[cell, c] if 0 < radiance[cell, c] < np.inf else 0.0
            out[cell, c] = max(light - taken[source, c] * (light - background[source, c]), 0.0)
    return out
