"""Tracked lights: each carries the exact light of one cell of the sky and stands at its flux centroid; cells go on from frame to
frame.

Lloyd's relaxation on the sphere, begun from the last frame's sites, on tiles of little light (tracked_tiles). Sites weigh
radiance^1.6, so that their density follows radiance^0.8: that minimises the sum of F^2 r over cells of flux F and radius r, the
mean square error at the edges of shadows. What relaxation is too slow for is done by splitting the cell that gains most and
merging the pair that costs least.
"""

from typing import NamedTuple

import numpy as np

from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.sampler.control import prefix_errors
from vemlight.sampler.density import LightMap
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.tracking.cells import centroids, lights_of_cells, move, relaxed, shares_of_sites
from vemlight.sampler.tracking.noise import LONGEST_GAP_S, NO_NOISE, Noise, with_map
from vemlight.sampler.tracking.split_merge import best_splits, cheapest_pair, exchanged
from vemlight.sampler.tracking.tiles import Tiles, received, tiles_from_map

FIRST_STEPS, STEPS = 12, 2  # Lloyd's steps in the first frame, and in every other
CHANGES = 16  # one light in so many, and at least one, is added in a frame when more are wanted,
GROWTH = 4  # and in a round of the first frame, or of one with sudden light
MOST_CHANGES = 6  # splits paid by merges in a frame of sudden light: each costs as much time as two of Lloyd's steps
SUDDEN = 2.0  # times the usual unrest: light has changed faster than sites move
NOTABLE = 0.02**2  # unrest over squared power below which nothing is urgent: its root is about the error of the irradiance
PACE = 8  # frames between splits when it has not
USUAL = 0.2  # of the way that the usual unrest goes to this frame's: a memory of five frames
ORDER = 0.75  # the error falls with this power of the number of lights: the slope of docs/charts/accuracy_still_lights.csv
AIM = 0.77  # of the error asked for: three times the 7 % to which 96 probes know it, below it
RISE = 2.0  # most that the number is multiplied by at once: too few lights for the lamps there are say how bad it is, not how many it takes
TRIALS = 4  # numbers of lights that are tried on the first frame
EASE_S = 0.12  # a new light leaves its parent's place with this time constant: three frames at 25 fps


class State(NamedTuple):
    """What is remembered between frames.

    ids: (n,) int64. sites: (n, 3) unit vectors. offset: (n, 3), what still parts a shown direction from its own. next_id: of the
    next light. usual: unrest over squared power lately. credit: of the next split, in splits. clean: (rows, cols, 3) float32,
    the last map without what was spoilt, None before the first frame. black: (rows, cols) uint8, frames for which a black cell
    was taken for spoilt.
    """

    coverage: Coverage
    time_s: float
    ids: np.ndarray
    sites: np.ndarray
    offset: np.ndarray
    next_id: int
    usual: float
    credit: float
    clean: np.ndarray | None
    black: np.ndarray
    noise: Noise


class Report(NamedTuple):
    """spoilt: cells with a nan, infinite or negative value. irradiance: (3,) float64, integral of the map, of its filled one
    when smoothing.
    """

    spoilt: int
    irradiance: np.ndarray


class Shares(NamedTuple):
    """What each cell holds.

    moment: (n, 4), power x direction, and power. pull: (n, 3), weight x direction. unease: (n,), root of its
    unrest. nearest, second: (tiles,) int64, the cell of each tile and the next one. share: (tiles,), what of a tile goes to the next one.
    """

    moment: np.ndarray
    pull: np.ndarray
    unease: np.ndarray
    nearest: np.ndarray
    second: np.ndarray
    share: np.ndarray


def initial_tracked() -> State:
    """The state before the first frame."""
    none = np.zeros((0, 3))
    return State("hemisphere", 0.0, np.zeros(0, np.int64), none, none, 0, 0.0, 0.0, None, np.zeros((0, 0), np.uint8), NO_NOISE)


def tracked_step(count: int, state: State, frame: SamplerInput, smoothing: bool = True) -> tuple[State, LightSet, Report]:
    """The lights, at most `count`, of a frame. Pure: an old state stays valid.

    Without smoothing the lights sum to the
    map's integral in every channel. With it, spoilt cells show what they showed last, noise is taken out and new lights
    leave their parents' places; the sum is then the smoothed map's. A map with fewer lit cells than lights has that many; the lights
    of a black one stay where they are, with irradiance 0.
    """
    radiance, coverage, time_s = frame.radiance, frame.coverage, frame.time_s
    if state.clean is None or coverage != state.coverage or state.clean.shape != radiance.shape:
        state = initial_tracked()._replace(coverage=coverage, time_s=time_s)
    noise = with_map(state.noise, radiance) if smoothing else NO_NOISE
    before = state.clean if smoothing and 0 < time_s - state.time_s < LONGEST_GAP_S else None
    clean, black, spoilt = received(radiance, before, state.black, noise.variance)
    tiles = tiles_from_map(clean, coverage, count, frame.bright_cells)
    irradiance = tiles.flux.sum(axis=1)
    power = float(irradiance @ LUMINANCE_WEIGHTS)
    known = state._replace(time_s=time_s, clean=clean, black=black, noise=noise)
    report = Report(spoilt, irradiance)
    if power <= 0:
        if not len(state.ids):
            return known, LightSet.of(np.arange(count), _even(count, coverage), np.zeros((count, 3))), report
        dark = np.zeros((len(state.ids), 3))
        return known, LightSet.of(state.ids, state.sites, dark), report

    after, held = _followed(known, tiles, count, power)
    fading = float(np.exp(-max(time_s - state.time_s, 0.0) / EASE_S)) if smoothing else 0.0
    after = after._replace(offset=after.offset * fading)
    directions, flux = lights_of_cells(tiles, after.sites, after.offset, held.moment, held.nearest, held.second, held.share)
    return after, LightSet(after.ids, directions, flux), report


def needed(light: LightMap, lights: LightSet, error: float, most: int) -> int:
    """How many lights, at most `most`, would keep the irradiance within `error` of the map's, judged by what these lights keep."""
    tint = lights.irradiance / np.where(light.irradiance > 0, light.irradiance, 1.0)
    if light.power <= 0:
        return 1
    now = float(prefix_errors(light, lights.directions.astype(np.float64), tint)[-1])
    wanted = len(lights.ids) * min((now / (AIM * error)) ** (1 / ORDER), RISE)
    return int(np.clip(np.ceil(wanted), 1, most))


def _even(count: int, coverage: Coverage) -> np.ndarray:
    """Directions (count, 3) spread evenly, on a spiral of golden angles."""
    k = np.arange(count)
    z = 1 - (k + 0.5) / count * (1 if coverage == "hemisphere" else 2)
    phi, s = k * np.pi * (3 - np.sqrt(5)), np.sqrt(1 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)


def _followed(state: State, tiles: Tiles, count: int, power: float) -> tuple[State, Shares]:
    """The state with sites that fit the tiles, and what their cells hold."""
    new = not len(state.ids)
    if new:
        zenith = np.array([[0.0, 0.0, 1.0]])
        state = state._replace(ids=np.zeros(1, np.int64), sites=zenith, offset=np.zeros((1, 3)), next_id=1)
    held = Shares(*shares_of_sites(tiles, state.sites))
    sudden = new or _unrest(held) > max(SUDDEN * state.usual, NOTABLE) * power**2

    # The number of lights: down at once, up a few in a frame unless all light is new.
    before = len(state.ids)
    while len(state.ids) > count:
        state, held = _merged(state, tiles, held)
    growing = len(state.ids) < count
    while growing:
        wanted = min(count - len(state.ids), max(1, len(state.ids) // (GROWTH if sudden else CHANGES)))
        found = len(state.ids)
        state, held = _split(state, tiles, held, wanted, sudden)
        growing = sudden and found < len(state.ids) < count

    # Splits paid by merges: several when light changed suddenly, else one now and then.
    credit = min(state.credit + 1 / PACE, 1.0)
    most = 0 if new or len(state.ids) < 2 else MOST_CHANGES if sudden else int(credit)
    if most:
        made, ids, sites, offset, found = exchanged(tiles, state.ids, state.sites, state.offset, state.next_id, *held, most, sudden)
        state, held = state._replace(ids=ids, sites=sites, offset=offset, next_id=state.next_id + made), Shares(*found)
        credit -= 0 if sudden else made

    # Lloyd's steps; none where the number changed, so that the others stay.
    if new or len(state.ids) == before:
        sites, found = relaxed(tiles, state.sites, held.pull, FIRST_STEPS if new else STEPS)
        state, held = state._replace(sites=sites), Shares(*found)
    level = _unrest(held) / power**2
    usual = level if new else state.usual + USUAL * (level - state.usual)
    return state._replace(usual=usual, credit=credit), held


def _unrest(held: Shares) -> float:
    return float(held.unease @ held.unease)


def _split(state: State, tiles: Tiles, held: Shares, most: int, sudden: bool) -> tuple[State, Shares]:
    """The cells, at most so many, whose split gains most cut in two; new lights begin at their parents' places unless light is `sudden`."""
    _, cells, halves = best_splits(tiles, held.nearest, state.sites, held.unease, most, sudden)
    sites, parents = state.sites.copy(), centroids(held.moment[cells], state.sites[cells])
    sites[cells] = halves[:, 0]
    born = state.next_id + np.arange(len(cells))
    state = state._replace(
        ids=np.concatenate([state.ids, born]),
        sites=np.concatenate([sites, halves[:, 1]]),
        offset=np.concatenate([state.offset, np.zeros((len(cells), 3)) if sudden else parents - halves[:, 1]]),
        next_id=state.next_id + len(cells),
    )
    return state, Shares(*shares_of_sites(tiles, state.sites))


def _merged(state: State, tiles: Tiles, held: Shares) -> tuple[State, Shares]:
    """The cheapest two cells made one."""
    _, kept, lost = cheapest_pair(held.nearest, held.second, held.moment, state.sites, held.unease)
    sites = state.sites.copy()
    move((held.pull[kept] + held.pull[lost])[None], sites[kept : kept + 1])
    sites = np.delete(sites, lost, axis=0)
    state = state._replace(ids=np.delete(state.ids, lost), sites=sites, offset=np.delete(state.offset, lost, axis=0))
    return state, Shares(*shares_of_sites(tiles, sites))
