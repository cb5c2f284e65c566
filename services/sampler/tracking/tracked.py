"""Tracked lights: each carries the exact light of one cell of the sky and stands at its flux centroid; cells persist from frame to frame.

Lloyd relaxation on the sphere, begun from the last frame's sites, on tiles of little light (tiles.py). Sites weigh radiance^1.6, so
that their density follows radiance^0.8: that minimises the sum of F^2 r over cells of flux F and radius r, the mean square error at the
edges of shadows. What relaxation is too slow for is done by splitting the cell that gains most and merging the pair that costs least.
"""

from typing import NamedTuple

import numpy as np

from vemlight.light.bright_cells import BrightCells
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.sampler.sampler_input import MAX_GAP_S, SamplerInput
from vemlight.sampler.tracking.cleaning import cleaned
from vemlight.sampler.tracking.extents import soft_lights
from vemlight.sampler.tracking.noise import NO_NOISE, Noise, noise_after
from vemlight.sampler.tracking.sources import (
    NO_SOURCES,
    SOURCE_RAD,
    Sources,
    narrowed,
    peaks_of,
    source_lights,
    sources_after,
    steady_extents,
)
from vemlight.sampler.tracking.split_merge import MAX_EXCHANGES, URGENT, Sites, best_splits, cheapest_pair, split_and_merge
from vemlight.sampler.tracking.tiles import Tiles, tiles_from_map
from vemlight.sampler.tracking.voronoi import Cells, cells_from_sites, centroids, lights_from_cells, lloyd_update, relax

MIN_TILE_COUNT = 128  # of lights that tiles are made for: a source of 1 % of the power has five tiles or more
FIRST_LLOYD_STEPS = 12  # in the first frame; any value in 3..24 comes within 1 % of the energy that 40 more frames reach
LLOYD_STEPS = 2  # in every other frame; any value in 1..4 does, within 3 % of the error on the bundled sequence
SCENE_CHANGE = 2.0  # times the running mean of the energy: light has changed faster than sites move
MIN_SCENE_CHANGE = 0.02**2  # relative energy below which nothing is urgent: its root is about the error of the irradiance
MEAN_GAIN = 0.2  # of the running mean of the energy: an average over about five frames
GROWTH = 4  # one light in so many, and at least one, is added in a round when more are wanted,
MAX_GROWTH = 4  # until there are so many times as before the frame: from 8 to 300 in three frames
EVEN_SITES = 4  # with which such light begins: the fewest whose cells all have a centroid
MIN_MEAN_DIRECTION = 0.1  # length, below which light is so even round the sphere that it has no centroid to split at
MIN_REST = 1e-9  # of the power, outside the sources, that is not rounding
NEVER_URGENT = np.inf  # for points: each exchange is seen as a light that goes and another that comes, where soft ones overlap
EXCHANGE_PERIOD = 8  # frames between exchanges, splits paid by merges, that are not urgent
WIDE_DIVIDED_FROM = 64  # soft lights, of which a wide source that one Gaussian does not stand for well has several
DIVIDED_FROM = 128  # soft lights: one for a lamp of 4 degrees is wrong by 1.1 % of all light, by more than so many are elsewhere
BIRTH_TIME_S = 0.12  # time constant with which a new light leaves its parent's direction: three frames at 25 fps


class TrackedState(NamedTuple):
    """What is remembered between frames.

    mean_energy: running mean of the relative energy, the cells' energy over squared power. split_credit: of the next exchange, 1 when it is
    due. clean: (rows, cols, 3) float32, the last map without what was invalid, None before the first frame. black_frames: (rows, cols)
    uint8, for how many frames a black cell has been inpainted.
    """

    coverage: Coverage
    time_s: float
    sites: Sites
    sources: Sources
    mean_energy: float
    split_credit: float
    clean: np.ndarray | None
    black_frames: np.ndarray
    noise: Noise


class TrackedReport(NamedTuple):
    """invalid_cells: with a nan, infinite or negative value. irradiance: (3,) float64, integral of the map, of the cleaned one when
    smoothing.
    """

    invalid_cells: int
    irradiance: np.ndarray


class Observed(NamedTuple):
    """A frame, cleaned. clean: (rows, cols, 3) float32. birth_decay: of the offsets of new lights, since the last frame."""

    clean: np.ndarray
    bright_cells: BrightCells
    invalid_cells: int
    birth_decay: float


def initial_tracked(next_id: int = 0) -> TrackedState:
    """The state before the first frame, or before the first after a jump, whose lights have ids from `next_id` on."""
    sites = Sites(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), next_id)
    return TrackedState("hemisphere", 0.0, sites, NO_SOURCES, 0.0, 0.0, None, np.zeros((0, 0), np.uint8), NO_NOISE)


def tracked_step(
    count: int, state: TrackedState, frame: SamplerInput, smoothing: bool = True, soft: bool = False
) -> tuple[TrackedState, LightSet, TrackedReport]:
    """The lights, at most `count`, of a frame. Pure: an old state stays valid.

    soft: they have extents, and a compact source is one of them.

    Without smoothing the lights sum to the map's integral in every channel. With it, invalid cells show what they showed last, noise is
    taken out and new lights leave their parents' directions gradually; the sum is then the smoothed map's. A map with fewer lit cells than
    lights has that many; the lights of a black one stay where they are, with irradiance 0.
    """
    state, observed = observe(state, frame, smoothing)
    state, lights, tiles = lights_of(count, state, observed, soft)
    return state, lights, TrackedReport(observed.invalid_cells, tiles.flux.sum(axis=1))


def observe(state: TrackedState, frame: SamplerInput, smoothing: bool) -> tuple[TrackedState, Observed]:
    """The state with the clean map, noise and time of a frame, and what its lights are made from."""
    radiance, coverage, time_s = frame.radiance, frame.coverage, frame.time_s
    if state.clean is None or coverage != state.coverage or state.clean.shape != radiance.shape:
        state = initial_tracked(state.sites.next_id)._replace(coverage=coverage, time_s=time_s)
    noise = noise_after(state.noise, radiance) if smoothing else NO_NOISE
    passed_s = time_s - state.time_s
    previous = state.clean if smoothing and 0 < passed_s < MAX_GAP_S else None
    clean, black_frames, invalid_cells = cleaned(radiance, previous, state.black_frames, noise.variance)
    birth_decay = float(np.exp(-max(passed_s, 0.0) / BIRTH_TIME_S)) if smoothing else 0.0
    state = state._replace(time_s=time_s, clean=clean, black_frames=black_frames, noise=noise)
    return state, Observed(clean, frame.bright_cells, invalid_cells, birth_decay)


def lights_of(count: int, state: TrackedState, observed: Observed, soft: bool) -> tuple[TrackedState, LightSet, Tiles]:
    """The lights, at most `count`, of what was observed after a state, and the tiles that they are to be judged by."""
    tiles = tiles_from_map(observed.clean, state.coverage, max(count, MIN_TILE_COUNT if soft else 1), observed.bright_cells)
    power = float(tiles.power.sum())
    if power <= 0:
        dark = _dark_lights(state, count, state.coverage)
        return state, dark._replace(covariances=np.zeros((len(dark.ids), 6), np.float32)) if soft else dark, tiles
    if soft:
        return _soft_lights(state, tiles, count)
    # Sites that follow the light, and new lights a little nearer to their own directions.
    state, cells = _tracked_sites(state, tiles, count, power, NEVER_URGENT)
    peaks = peaks_of(tiles)
    sources, lit = sources_after(state.sources, peaks, state.time_s, state.sites.next_id, len(state.sites.ids) // 2)
    state = _named_after_sources(state, sources, np.arange(len(lit)), centroids(cells.moment, state.sites.directions), cells.moment[:, 3])
    sites = state.sites._replace(offsets=state.sites.offsets * observed.birth_decay)
    directions, flux = lights_from_cells(tiles, cells.moment, cells.assignment, sites.directions, sites.offsets)
    return state._replace(sites=sites), LightSet(sites.ids, directions, flux), tiles


def _soft_lights(state: TrackedState, tiles: Tiles, count: int) -> tuple[TrackedState, LightSet, Tiles]:
    """Lights with extent: compact sources, each a light of its own unless it is divided, and those that follow the rest."""
    peaks = peaks_of(tiles)
    sources, lit = sources_after(state.sources, peaks, state.time_s, state.sites.next_id, count // 2)
    if count < WIDE_DIVIDED_FROM:
        sources = sources._replace(divided=np.zeros(len(sources.ids), bool))
    parted = np.flatnonzero(sources.divided[: len(lit)] | (count >= DIVIDED_FROM))
    whole = np.setdiff1d(np.arange(len(lit)), parted)
    source_tiles, flux, rest = source_lights(tiles, peaks, lit[whole])
    ids, power = sources.ids[whole], float(rest.power.sum())
    state = state._replace(sites=_moved_with(_without_ids(state.sites, np.delete(sources.ids, parted)), sources, parted))
    if power <= MIN_REST * float(tiles.power.sum()):
        lights = LightSet.of(ids, source_tiles.directions, flux, np.zeros((len(ids), 6)))
        return state._replace(sources=sources), lights, tiles
    state, cells = _tracked_sites(state, rest, count - len(ids), power, URGENT)
    sites = state.sites
    lights = soft_lights(tiles, np.append(ids, sites.ids), sites.directions, cells.assignment, source_tiles)
    parts = lights.irradiance[len(ids) :] @ LUMINANCE_WEIGHTS
    state = _named_after_sources(state, sources, parted, lights.directions[len(ids) :], parts)
    lights = lights._replace(ids=np.append(ids, state.sites.ids))
    lights, sources, narrowing = steady_extents(lights, state.sources, whole)
    return state._replace(sources=sources), lights, narrowed(tiles, source_tiles, narrowing)


def _moved_with(sites: Sites, sources: Sources, divided: np.ndarray) -> Sites:
    """The sites at the sources `divided` (k,), moved as these have: cells of half a degree do not find a lamp that moves by one."""
    directions = sites.directions.copy()
    for n in divided:
        near = sites.directions @ (sources.directions[n] - sources.steps[n]) > np.cos(SOURCE_RAD)
        moved = sites.directions[near] + sources.steps[n]
        directions[near] = moved / np.linalg.norm(moved, axis=1, keepdims=True)
    return sites._replace(directions=directions)


def _without_ids(sites: Sites, taken: np.ndarray) -> Sites:
    """The sites with new ids where theirs are taken."""
    next_id = max(sites.next_id, int(taken.max(initial=-1)) + 1)
    ids, clash = sites.ids.copy(), np.isin(sites.ids, taken)
    ids[clash] = next_id + np.arange(clash.sum())
    return sites._replace(ids=ids, next_id=next_id + int(clash.sum()))


def _named_after_sources(
    state: TrackedState, sources: Sources, divided: np.ndarray, directions: np.ndarray, power: np.ndarray
) -> TrackedState:
    """The state in which the strongest light at each of the sources `divided` (k,) has the source's id, which it takes from the one that
    had it. A new source takes the id of its strongest light. directions (n, 3), power (n,): of the sites' lights.
    """
    sites, known, names = state.sites, state.sources.ids, sources.ids.copy()
    ids = sites.ids.copy()
    for n in divided:
        near, own = directions @ sources.directions[n] > np.cos(SOURCE_RAD), names[n]
        if near.any():
            strongest = int(np.where(near, power, -1.0).argmax())
            if own not in known and ids[strongest] not in names:
                names[n] = ids[strongest]
            elif own != ids[strongest]:
                ids[ids == own] = ids[strongest]
                ids[strongest] = own
    next_id = max(sites.next_id, int(names.max(initial=-1)) + 1)
    return state._replace(sites=sites._replace(ids=ids, next_id=next_id), sources=sources._replace(ids=names))


def _dark_lights(state: TrackedState, count: int, coverage: Coverage) -> LightSet:
    """The lights of a black map: where they were, or spread evenly before the first light."""
    alone = ~np.isin(state.sources.ids, state.sites.ids)  # sources of points are among the sites
    ids = np.append(state.sources.ids[alone], state.sites.ids)
    if len(ids):
        return LightSet.of(ids, np.concatenate([state.sources.directions[alone], state.sites.directions]), np.zeros((len(ids), 3)))
    return LightSet.of(np.arange(count), _golden_spiral(count, coverage), np.zeros((count, 3)))


def _golden_spiral(count: int, coverage: Coverage) -> np.ndarray:
    """Directions (count, 3) spread evenly, on a spiral of golden angles."""
    k = np.arange(count)
    z = 1 - (k + 0.5) / count * (1 if coverage == "hemisphere" else 2)
    phi, s = k * np.pi * (3 - np.sqrt(5)), np.sqrt(1 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)


def _tracked_sites(state: TrackedState, tiles: Tiles, count: int, power: float, urgent: float) -> tuple[TrackedState, Cells]:
    """The state with sites that fit the tiles, and their cells. urgent: of the energy, above which an exchange does not wait."""
    first = not len(state.sites.ids)
    sites = _first_sites(tiles, count, state.sites.next_id) if first else state.sites
    cells = cells_from_sites(tiles, sites.directions)
    changed = first or _energy(cells) > max(SCENE_CHANGE * state.mean_energy, MIN_SCENE_CHANGE) * power**2

    # The number of lights: down at once, up a few in a frame unless the scene changed.
    before = len(sites.ids)
    while len(sites.ids) > count:
        sites, cells = _merged(sites, tiles, cells)
    wanted, grown = count if first else min(count, MAX_GROWTH * before), 0
    while grown < len(sites.ids) < wanted:
        grown = len(sites.ids)
        sites, cells = _split(sites, tiles, cells, min(wanted - grown, max(1, grown // GROWTH)), changed)

    # Splits paid by merges: several when much can be saved, else one now and then.
    credit = min(state.split_credit + 1 / EXCHANGE_PERIOD, 1.0)
    spare = MAX_EXCHANGES if changed else int(credit)
    if not first and len(sites.ids) >= 2 and (spare or urgent < 1):
        exchanges, sites, cells = split_and_merge(tiles, sites, cells, spare, urgent, changed)
        credit -= 1 if exchanges and credit >= 1 and not changed else 0

    # Lloyd updates; none where the number changed, so that the other lights stay.
    if first or len(sites.ids) == before:
        directions, cells = relax(tiles, sites.directions, cells.site_moment, FIRST_LLOYD_STEPS if first else LLOYD_STEPS)
        sites = sites._replace(directions=directions)
    energy = _energy(cells) / power**2
    mean_energy = energy if first else state.mean_energy + MEAN_GAIN * (energy - state.mean_energy)
    return state._replace(sites=sites, mean_energy=mean_energy, split_credit=credit), cells


def _first_sites(tiles: Tiles, count: int, next_id: int) -> Sites:
    """One site to be split, or several where light is so even round the sphere that it has no centroid."""
    even = np.linalg.norm(tiles.direction @ tiles.power) < MIN_MEAN_DIRECTION * tiles.power.sum()
    directions = np.array([[0.0, 0.0, 1.0]])
    if even:
        nearest = np.unique((_golden_spiral(min(count, EVEN_SITES), "sphere") @ tiles.direction).argmax(axis=1))
        directions = np.ascontiguousarray((tiles.direction / np.linalg.norm(tiles.direction, axis=0))[:, nearest].T)
    return Sites(next_id + np.arange(len(directions)), directions, np.zeros_like(directions), next_id + len(directions))


def _energy(cells: Cells) -> float:
    return float(cells.root_energy @ cells.root_energy)


def _split(sites: Sites, tiles: Tiles, cells: Cells, max_count: int, changed: bool) -> tuple[Sites, Cells]:
    """The cells whose split gains most, at most `max_count`, cut in two. New lights begin at their parents' unless the scene changed."""
    _, chosen, halves = best_splits(tiles, sites.directions, cells, max_count, changed)
    directions, parents = sites.directions.copy(), centroids(cells.moment[chosen], sites.directions[chosen])
    directions[chosen] = halves[:, 0]
    sites = Sites(
        np.concatenate([sites.ids, sites.next_id + np.arange(len(chosen))]),
        np.concatenate([directions, halves[:, 1]]),
        np.concatenate([sites.offsets, np.zeros((len(chosen), 3)) if changed else parents - halves[:, 1]]),
        sites.next_id + len(chosen),
    )
    return sites, cells_from_sites(tiles, sites.directions)


def _merged(sites: Sites, tiles: Tiles, cells: Cells) -> tuple[Sites, Cells]:
    """The cheapest two cells made one."""
    _, larger, smaller = cheapest_pair(sites.directions, cells)
    directions = sites.directions.copy()
    lloyd_update((cells.site_moment[larger] + cells.site_moment[smaller])[None], directions[larger : larger + 1])
    sites = sites._replace(
        ids=np.delete(sites.ids, smaller),
        directions=np.delete(directions, smaller, axis=0),
        offsets=np.delete(sites.offsets, smaller, axis=0),
    )
    return sites, cells_from_sites(tiles, sites.directions)
