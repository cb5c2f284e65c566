"""The step of the fuse service: one moment's maps of all cameras in, one map and the near lights out. A pure function of its state."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vemlight.fuse.compact_sources import MAX_SOURCES, CompactSources, compact_sources
from vemlight.fuse.gains import Gains, gains_by_lights, gains_by_walls, initial_gains
from vemlight.fuse.matching import SEES, SOURCE_NUMBERS, Matches, SeenSources, from_camera, is_seen_at, matches
from vemlight.fuse.rest import CameraView, FusedMap, fused, fused_layout, layout_of, without_lights
from vemlight.fuse.rig_file import CameraRig
from vemlight.fuse.tracks import HITS, Followed, Tracks, followed, no_tracks, tracks_of
from vemlight.fuse.triangulation import FLUX_SIGMA, UNKNOWN_FLUX
from vemlight.fuse.trust import FRAMES, evidence
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.near_lights import MAX_NEAR_LIGHTS, NearLightSet
from vemlight.light.sphere import cell_from_direction

MIN_SUBJECT_M = 0.05  # a camera nearer to the subject counts as if it were so far, so that it does not count alone
FLUX_NOISE = 0.01  # of ln flux, new each frame: 2 % a cell over the four cells of the smallest lamp
SATURATED_SIGMA = 1.0  # of ln flux where pixels are at the sensor's highest code
SATURATED_SHARE = 0.5  # of the map's brightest cell: sources with such a peak may hold them
ALONE_RAD = np.radians(3.0)  # from the next source: twice the reach of a source's rim
MIN_OF_NEAR = 0.01  # of the near lights' irradiance: what curved mirrors show is weaker, and no place holds it
MIN_CLEAR_M = 0.05  # of a light's surface from every camera


class FuseState(NamedTuple):
    """What fusing remembers between frames.

    rig: the cameras. weights: (cameras,) of each map in the mean, sum 1. gains: what brings the cameras to one radiance unit. lights: near
    and far ones, which more than one camera sees, and those that are off. misfit, trust: means of the last frames' misfit and ln odds, see
    trust.py; None before the first light.
    """

    rig: CameraRig
    weights: np.ndarray
    gains: Gains
    lights: Followed
    misfit: float | None
    trust: float | None
    hits: int = HITS

    @staticmethod
    def start(rig: CameraRig, subject: tuple[float, float, float] | None = None) -> "FuseState":
        """Before the first frame. subject: place, m, whose light is wanted: cameras count by 1 / distance^2 from it; None: all alike."""
        weights = np.ones(len(rig.camera))
        if subject is not None:
            weights = 1 / np.maximum(np.linalg.norm(rig.places - np.asarray(subject), axis=1), MIN_SUBJECT_M) ** 2
        none = no_tracks(len(rig.camera))
        return FuseState(rig, weights / weights.sum(), initial_gains(rig), Followed(none, none, 0), None, None)


class FuseReport(NamedTuple):
    """What is published beside map and near lights.

    irradiance: (3,) float64, integral at the rig's centre of the fused map and the near lights together. sources: compact sources seen,
    of all cameras. located: near lights. hidden: of them, not located in this frame. unexplained: sources that two cameras should see and
    that no place explains, as when a pose is wrong by more than the rig file says. silent: names of cameras without a map, or without any
    light in it beside others that have some. gains: (cameras, 3), in use. uncovered: fraction of the fused map that no camera sees. misfit:
    how far the directions of lights are from one place each, as trust.py has it. believed: whether poses as the rig file has them are the
    likelier explanation, so that near lights are published. limits: those of this program that were reached, in words.
    """

    irradiance: np.ndarray
    sources: int
    located: int
    hidden: int
    unexplained: int
    silent: tuple[str, ...]
    gains: np.ndarray
    uncovered: float
    misfit: float
    believed: bool
    limits: tuple[str, ...]


def fuse_still(
    state: FuseState, maps: Sequence[EnvironmentMap | None], saturated: Sequence[bool] = ()
) -> tuple[EnvironmentMap, NearLightSet, FuseReport]:
    """As `fuse_step`, of one moment alone: its lights are published though they were seen once."""
    known, *_ = fuse_step(state, maps, saturated)  # gains are known after it, and apply to the next
    _, rest, near, report = fuse_step(state._replace(gains=known.gains, hits=1), maps, saturated)
    return rest, near, report


def fuse_step(
    state: FuseState, maps: Sequence[EnvironmentMap | None], saturated: Sequence[bool] = ()
) -> tuple[FuseState, EnvironmentMap, NearLightSet, FuseReport]:
    """The fused map, in the world's axes and true at the rig's centre, without the near lights, and these.

    maps: one of each camera in the rig's order, in its own axes; None where it is silent, as one is taken to be that has no light beside
    others. saturated: of each camera, whether its map has pixels at the sensor's highest code; left out: none has. Raises ValueError when
    all are silent.
    """
    if all(each is None for each in maps):
        raise ValueError("all cameras are silent")
    maps = _lit(maps)
    gains = gains_by_walls(state.gains, state.rig, maps)
    in_use = np.exp(gains.ln)
    found = [compact_sources(each) if each else None for each in maps]
    seen = _seen(state.rig, in_use, maps, found, saturated)
    seen.table[:, :, 6] += gains.sigma[:, None] ** 2
    matched = matches(seen)
    lights = followed(state.lights, _measured(matched, seen, found), _is_still_lit(state.lights.tracks, seen))
    gains = gains_by_lights(gains, state.rig, matched, _known_fluxes(found, in_use, seen), seen.offsets)
    near, seen_near = _published(lights.tracks, state.rig, state.hits)
    free = _unexplained(matched, seen, found)
    unexplained = sum(len(each) for each in free)
    now = evidence(matched, seen, free)
    trust = _mean(state.trust, now and now.ln_odds)
    misfit = _mean(state.misfit, now and now.misfit)
    believed = trust is None or trust > 0
    unexplained += 0 if believed else int(np.count_nonzero(near.sources >= 0))
    near = near if believed else near.take(np.zeros(len(near.ids), bool))
    points = _near_lights(near, state.rig.centre, max(misfit or 0.0, 1.0))
    rest = _rest(state, in_use, maps, found, near, seen)
    report = FuseReport(
        irradiance=rest.irradiance + points.irradiance_at(state.rig.centre).sum(axis=0),
        sources=int(seen.counts.sum()),
        located=len(near.ids),
        hidden=int(np.count_nonzero(near.missed)),
        unexplained=unexplained,
        silent=tuple(camera.name for camera, each in zip(state.rig.camera, maps, strict=True) if each is None),
        gains=in_use,
        uncovered=rest.uncovered,
        misfit=misfit or 0.0,
        believed=believed,
        limits=_limits(state.rig, found, matched, seen_near),
    )
    return state._replace(gains=gains, lights=lights, misfit=misfit, trust=trust), rest.map, points, report


def _lit(maps: Sequence[EnvironmentMap | None]) -> list[EnvironmentMap | None]:
    """The maps; None for one without light beside others with it: its lens is covered, and it tells neither light nor darkness."""
    lit = [each is not None and bool((each.radiance > 0).any()) for each in maps]
    return [each if here or not any(lit) else None for each, here in zip(maps, lit, strict=True)]


def _known_fluxes(found: Sequence[CompactSources | None], gains: np.ndarray, seen: SeenSources) -> list[np.ndarray]:
    """Flux (n, 3) of each camera's sources in the rig's unit; nan where pixels are saturated."""
    fluxes = []
    for k, each in enumerate(found):
        flux = each.flux * gains[k] if each else np.zeros((0, 3))
        fluxes.append(np.where(seen.table[k, : len(flux), 6:7] < UNKNOWN_FLUX, flux, np.nan))
    return fluxes


def _seen(
    rig: CameraRig,
    gains: np.ndarray,
    maps: Sequence[EnvironmentMap | None],
    found: Sequence[CompactSources | None],
    saturated: Sequence[bool],
) -> SeenSources:
    """The sources of all cameras in the world, in one unit."""
    cameras = len(maps)
    counts = np.array([len(each.flux) if each else 0 for each in found], np.int64)
    table, chroma = np.zeros((cameras, max(int(counts.max()), 1), SOURCE_NUMBERS)), np.zeros((cameras, max(int(counts.max()), 1), 3))
    for k, (each, camera) in enumerate(zip(found, rig.camera, strict=True)):
        if each is None or not counts[k]:
            continue
        flux = each.flux * gains[k]
        own = slice(0, counts[k])
        table[k, own, :3] = each.directions @ camera.world_from_camera.T
        table[k, own, 3] = np.log(luminance_from_rgb(flux))
        table[k, own, 4], table[k, own, 5] = each.noise, each.fixed
        cut = each.peak > SATURATED_SHARE * each.peak.max() if saturated and saturated[k] else np.zeros(counts[k], bool)
        table[k, own, 6], table[k, own, 7] = np.where(cut, SATURATED_SIGMA, FLUX_SIGMA) ** 2, FLUX_NOISE**2
        chroma[k, own] = flux / flux.sum(axis=1, keepdims=True)
    limits = np.array([2.0 if each is None else SEES if each.coverage == "hemisphere" else -2.0 for each in maps])
    axes = np.array([camera.world_from_camera[:, 2] for camera in rig.camera])
    pose = np.array([np.radians(rig.pose_deg), rig.pose_m])
    return SeenSources(table, counts, chroma, rig.centre - rig.places, axes, limits, pose)


def _measured(matched: Matches, seen: SeenSources, found: Sequence[CompactSources | None]) -> Tracks:
    """The frame's lights, with the mean colour and extent of their sources.

    Two cameras alone are not believed where another source is near: one of them may see two lamps as one.
    """
    count = len(matched.fit)
    chroma, spread, sure, alone = np.zeros((count, 3)), np.zeros(count), np.ones(count, bool), np.ones(count, bool)
    cameras, coloured = np.maximum((matched.sources >= 0).sum(axis=1), 1), np.zeros(count)
    for k, each in enumerate(found):
        if each is None or not len(each.flux):
            continue
        there = matched.sources[:, k] >= 0
        own = matched.sources[there, k]
        p = matched.fit[there, :3] + matched.fit[there, 3:4] * seen.offsets[k]
        weight = np.where(seen.table[k, own, 6] < UNKNOWN_FLUX, 1.0, 1e-3)  # colours of saturated pixels only where there are no others
        chroma[there] += weight[:, None] * seen.chroma[k, own]
        coloured[there] += weight
        spread[there] += each.spread[own] * (p * p).sum(axis=1)
        sure[there] &= each.sure[own]
        alone[there] &= (each.directions[own] @ each.directions.T > np.cos(ALONE_RAD)).sum(axis=1) == 1
    return tracks_of(matched, chroma / np.maximum(coloured, 1e-9)[:, None], spread / cameras, sure & (alone | (cameras > 2)))


def _is_still_lit(tracks: Tracks, seen: SeenSources) -> np.ndarray:
    """Whether any camera has a source where it would see each light."""
    lit = np.zeros(len(tracks.ids), bool)
    for k in range(len(seen.counts)):
        own = seen.table[k, : seen.counts[k]]
        lit |= is_seen_at(tracks.u, tracks.rho, tracks.s, seen.offsets[k], own).any(axis=1)
    return lit


def _published(tracks: Tracks, rig: CameraRig, hits: int) -> tuple[Tracks, int]:
    """The near lights: seen often enough, outside of every camera, and no weak rays of curved mirrors. And how many there are, of which the
    strongest MAX_NEAR_LIGHTS are published.
    """
    near = tracks.take(tracks.near & (tracks.hits >= hits))
    reach = np.sqrt(2 * near.spread) / near.rho + MIN_CLEAR_M
    away = np.linalg.norm((near.offsets() + rig.centre)[:, None] - rig.places[None], axis=2).min(axis=1, initial=np.inf)
    near = near.take(away > reach)
    flux = np.exp(near.s)
    near = near.take(flux >= MIN_OF_NEAR * flux.sum())
    return near.take(np.sort(np.argsort(-near.s, kind="stable")[:MAX_NEAR_LIGHTS])), len(near.ids)


def _limits(rig: CameraRig, found: Sequence[CompactSources | None], matched: Matches, near: int) -> tuple[str, ...]:
    """Which limits this moment reached, in words; what is beyond them stays in the directional lights."""
    said = [
        f"camera {camera.name} sees more than {MAX_SOURCES} compact sources; lights are located by the strongest {MAX_SOURCES}"
        for camera, each in zip(rig.camera, found, strict=True)
        if each and each.beyond
    ]
    if matched.cut:
        said.append("so many sources look alike that not all ways to match them are tried; some lights may stay directional")
    if near > MAX_NEAR_LIGHTS:
        said.append(f"there are more than {MAX_NEAR_LIGHTS} near lights; the weaker ones stay directional")
    return tuple(said)


def _near_lights(near: Tracks, centre: np.ndarray, misfit: float) -> NearLightSet:
    """The lights as they are handed on; what fits worse than promised is known less well (Birge 1932)."""
    flux = np.exp(near.s)[:, None] * near.chroma / luminance_from_rgb(near.chroma)[:, None]
    sigma = np.sqrt(misfit * np.trace(near.place_covariances(), axis1=1, axis2=2))
    return NearLightSet.of(
        near.ids, centre + near.offsets(), flux / near.rho[:, None] ** 2, np.sqrt(2 * near.spread) / near.rho, sigma
    )


def _unexplained(matched: Matches, seen: SeenSources, found: Sequence[CompactSources | None]) -> list[np.ndarray]:
    """Of each camera, the sources that two should see and that are no light's; what another camera may have left out says nothing."""
    free = []
    for k, each in enumerate(found):
        explained = np.zeros(seen.counts[k], bool)
        explained[matched.sources[matched.sources[:, k] >= 0, k]] = True
        others = (seen.table[k, : seen.counts[k], :3] @ seen.axes.T > seen.limits).sum(axis=1)
        free.append(np.flatnonzero(~explained & each.sure & (others >= 2)) if each else np.zeros(0, np.int64))
    return free


def _mean(before: float | None, now: float | None) -> float | None:
    """Of the last frames."""
    return before if now is None else now if before is None else before + (now - before) / FRAMES


def _rest(
    state: FuseState,
    gains: np.ndarray,
    maps: Sequence[EnvironmentMap | None],
    found: Sequence[CompactSources | None],
    near: Tracks,
    seen: SeenSources,
) -> FusedMap:
    """The mean of the maps without the near lights."""
    views = []
    for k, (each, sources, camera) in enumerate(zip(maps, found, state.rig.camera, strict=True)):
        if each is None or sources is None:
            continue
        taken = _taken(k, each, sources, near, seen, camera.world_from_camera, gains[k])
        views.append(CameraView(without_lights(each, sources, taken), camera.world_from_camera, gains[k], float(state.weights[k])))
    layouts = [layout_of(each.radiance, each.coverage) if each else None for each in maps]
    first = next(layout for layout in layouts if layout)  # of a camera that is silent the layout is taken to be the others'
    cameras = zip(layouts, state.rig.camera, strict=True)
    return fused(views, fused_layout(tuple((layout or first, camera.world_from_camera.tobytes()) for layout, camera in cameras)))


def _taken(
    k: int, seen_map: EnvironmentMap, sources: CompactSources, near: Tracks, seen: SeenSources, world_from_camera: np.ndarray,
    gain: np.ndarray,
) -> np.ndarray:
    """The share (n, 3) of each source of camera k that is light of near lights: all of one that was matched; of one in whose cells a light
    stands that was not, what that light sends there.
    """
    taken = np.zeros((len(sources.flux), 3))
    if not len(taken) or not len(near.ids):
        return taken
    own = near.sources[:, k]
    taken[own[own >= 0]] = 1.0
    directions, ln_flux = from_camera(near.u, near.rho, near.s, seen.offsets[k])
    rows, cols, _ = seen_map.radiance.shape
    row, col = cell_from_direction(directions @ world_from_camera, rows, cols, seen_map.coverage)
    flux = np.exp(ln_flux)[:, None] * near.chroma / luminance_from_rgb(near.chroma)[:, None] / gain
    for n in np.flatnonzero((own < 0) & (row < rows)):
        source = sources.owner[int(row[n]) * cols + int(col[n]) % cols]
        if source >= 0:
            taken[source] += flux[n] / np.maximum(sources.flux[source], 1e-30)
    return np.minimum(taken, 1.0)
