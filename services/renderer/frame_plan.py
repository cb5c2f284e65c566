"""What a frame draws: which lights, which shadow maps at which resolution, which cached lookups, which passes.

`plan` is pure and needs no GL: from the state that the last frame left, what this frame shows and the measured costs it decides all that
`Renderer.draw` then does. A state also describes what is cached on the GPU once its frame is drawn, so that a plan made from any state
gives the same picture: if the GPU holds another state's contents, `draw` first draws again what this state describes.
"""

from collections.abc import Mapping
from functools import partial

import numpy as np

from vemlight import settings
from vemlight.light.extent import Extents, received
from vemlight.light.light_set import LightSet
from vemlight.light.reflected_light import reflected_light
from vemlight.renderer import pass_table
from vemlight.renderer.accumulation import spread_points
from vemlight.renderer.frame import NO_LIGHT, AccumulationPass, FrameInput, FramePlan, FrameSetup, FrameState, PassRun
from vemlight.renderer.frame_budget import (
    COARSE_WEIGHT,
    MAX_REDRAWN,
    WARM_UP_FRAMES,
    Budget,
    CostModel,
    FrameWork,
    MapDemand,
    affordable_maps,
    affordable_traces,
    bounce_affordable,
    coarsening,
    map_work,
    strongest_lights,
    updated_demand,
)
from vemlight.renderer.gl.constants import NEAR_BATCH, MaterialKind
from vemlight.renderer.near_planning import all_near, lights_in_time, map_works, near_mapped, near_traced
from vemlight.renderer.pass_order import Lighting, drawing_passes, output_passes
from vemlight.renderer.passes.lights.light_regions import SPHERE_REGIONS, light_regions
from vemlight.renderer.passes.lights.traced_lights import (
    TracedBatch,
    TracedLayers,
    lights_of,
    live_rays,
    renumbered,
    traced_batch,
    traced_batches,
)
from vemlight.renderer.passes.luminaires.luminaire_map_plan import stale_luminaire_maps
from vemlight.renderer.passes.near_lights.near_light_plan import LitBy, joined, same_light
from vemlight.renderer.passes.shadow_maps.casters import placed_casters, scene_casters
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import (
    Batch,
    ShadowSetup,
    all_batches,
    cached_batch,
    halvings_by_id,
    max_atlas_side,
    with_lookups,
    with_moved_casters,
    with_reflection,
    without_lookups,
)
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import MAX_COARSENING, map_resolutions
from vemlight.renderer.scene.materials import Colour, emits, material_kind
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose, same_places, scene_pose
from vemlight.renderer.scene.view import PixelSample, pixel_samples

ACCUMULATED_RESOLUTION = 256  # of each map of a pass of accumulation, if by power: four and a half for a degree, a cell of the polar map
COARSE_FROM = 120_000  # pixels, from which on weak lights are summed on coarse pixels live: 480 x 270 is such a picture, 320 x 240 is not
MAX_CACHE_BYTES = 2**29  # of cached visibility: 256 maps at 1920 x 1080; beyond that lights are looked up in the sum itself


def frame_setup(scene: Scene, settings: settings.Renderer, samples: int, max_texture_side: int, traced: bool = False) -> FrameSetup:
    """The setup for `samples` of each pixel on a GL whose largest texture has so many texels a side. traced: shadows are by rays."""
    resolutions = map_resolutions(settings.shadow_map)
    regions = light_regions(SPHERE_REGIONS if settings.light_regions is None else settings.light_regions)
    shadows = ShadowSetup(scene_casters(scene, resolutions.choices, not traced), regions, resolutions, max_atlas_side(max_texture_side))
    materials = [mesh.material for mesh in scene.meshes]
    return FrameSetup(
        scene=scene,
        size=(settings.width, settings.height),
        samples=tuple(pixel_samples(samples)),
        target_ms=settings.frame_ms or 0.0,
        tone=settings.tone,
        shadows=shadows,
        kinds=frozenset(material_kind(material) for material in materials),
        emissive=any(emits(material) for material in materials),
        rest=scene_pose(scene, 0.0),
        traced=traced,
        bounces=traced and settings.bounces > 0,
        coarse=traced and bool(settings.frame_ms) and samples == 1 and settings.width * settings.height >= COARSE_FROM,
    )


def initial_state(setup: FrameSetup) -> FrameState:
    """Before the first frame: nothing is cached."""
    casters = setup.shadows.casters
    at_rest = placed_casters(casters, np.tile(np.eye(4), (len(setup.scene.meshes), 1, 1)))
    return FrameState(
        placed=placed_casters(casters, setup.rest.matrices, at_rest),
        halvings={},
        coarsening=0,
        demand=MapDemand(),
        bounce=True,
        maps=None,
        layers=None,
        coarse_layers=None,
        near_layers=None,
        light_weight=1.0,
        gathered={},
        edge_samples=0,
        lookup_pose=None,
        g_buffer=None,
        luminaire_maps=(None,) * len(setup.scene.luminaires),
    )


def plan(setup: FrameSetup, state: FrameState, shown: FrameInput, costs: CostModel) -> tuple[FramePlan, FrameState]:
    """The frame that shows this, and the state after it. With a target time it draws what the costs leave time for."""
    after = _with_pose(setup, state, shown.pose)
    if isinstance(shown.lights, AccumulationPass):
        after, lighting = _accumulated(setup, after, shown, shown.lights)
    elif setup.target_ms:
        after, lighting = _in_time(setup, after, shown, shown.lights, costs)
    else:
        after, lighting = _whole(setup, after, shown, shown.lights)
    reflected = reflected_light(lighting.lights, shown.environment) if setup.glossy else None
    if reflected is not None:
        lighting = lighting._replace(batches=tuple(with_reflection(batch, reflected) for batch in lighting.batches))
    stale = stale_luminaire_maps(setup.scene, state.luminaire_maps, shown.pose)
    runs, g_buffer = drawing_passes(setup, state.g_buffer, shown, lighting, reflected, any(stale))
    drawn_for = tuple(shown.pose if redrawn else pose for redrawn, pose in zip(stale, state.luminaire_maps, strict=True))
    kept = state.gathered if lighting.bounce and g_buffer is state.g_buffer else {}
    first = shown.lights.number % setup.bounce_sets if isinstance(shown.lights, AccumulationPass) else 0
    lit_by = LitBy(lighting.lights, joined(lighting.near))
    gathered = with_newest(kept, lit_by, setup.bounce_sets, first) if lighting.bounce else {}
    edge_samples = min(state.edge_samples + 1, setup.edge_samples) if g_buffer is state.g_buffer else 0
    if edge_samples > state.edge_samples:
        runs.insert(0, PassRun(pass_table.EDGES))
    after = after._replace(g_buffer=g_buffer, luminaire_maps=drawn_for, gathered=gathered, edge_samples=edge_samples)
    made = FramePlan(
        shown=shown,
        before=state,
        after=after,
        passes=tuple(runs),
        outputs=output_passes(shown),
        batches=lighting.batches,
        samples=lighting.samples,
        unshadowed=lighting.unshadowed,
        lights=lighting.lights,
        reflected=reflected,
        work=lighting.work,
        near=lighting.near,
        lit_by=lit_by,
    )
    return made, after


def with_newest(gathered: Mapping[int, LitBy], lights: LitBy, sets: int, first: int = 0) -> Mapping[int, LitBy]:
    """Under which lights each of the bounce's `sets` was gathered, the newest last, once another one was under these.

    One that was not yet, from `first` on, or else the oldest; none where that was under the same lights.
    """
    if len(gathered) < sets:
        return {**gathered, (first + len(gathered)) % sets: lights}
    (oldest, before), *others = gathered.items()
    if same_light(before, lights):
        return gathered
    return {**dict(others), oldest: lights}


def plan_upload(state: FrameState, picture: np.ndarray, shown: FrameInput) -> FramePlan:
    """The frame that shows a given picture, (height, width, 4) float32; it leaves the state as it is."""
    return FramePlan(shown, state, state, (PassRun(pass_table.UPLOAD),), output_passes(shown), uploaded=picture)


def budget_of(setup: FrameSetup, state: FrameState, costs: CostModel) -> Budget:
    """What the next frame may take, and what it would take if no surface moved."""
    return Budget(setup.target_ms, costs, state.demand, bounce=state.bounce and setup.bounces, light_weight=state.light_weight)


def _with_pose(setup: FrameSetup, state: FrameState, pose: ScenePose) -> FrameState:
    """The state once the casters stand there."""
    if np.array_equal(pose.matrices, state.placed.matrices):
        return state
    placed = placed_casters(setup.shadows.casters, pose.matrices, state.placed)
    maps = with_moved_casters(setup.shadows, state.maps, state.placed, placed) if state.maps else None
    return state._replace(placed=placed, maps=maps)


def _whole(setup: FrameSetup, state: FrameState, shown: FrameInput, lights: LightSet) -> tuple[FrameState, Lighting]:
    """All lights with all their maps drawn anew, or all traced."""
    if setup.traced:
        batches = traced_batches(setup.shadows, lights, _most_layers(setup.size))
    else:
        batches = all_batches(setup.shadows, state.placed, lights)
    unshadowed = _catcher_irradiance(setup, shown.pose, lights)
    near = all_near(setup, state, shown, _most_layers(setup.size))
    return state._replace(maps=None, layers=None, coarse_layers=None, near_layers=None), Lighting(
        lights, batches, setup.samples, unshadowed, bounce=setup.bounces, near=near
    )


def _accumulated(setup: FrameSetup, state: FrameState, shown: FrameInput, wanted: AccumulationPass) -> tuple[FrameState, Lighting]:
    """All lights of a pass, at one sample of each pixel that no other pass has."""
    lights = wanted.light.of_pass(wanted.number)
    ((x, y),) = spread_points(wanted.number, 1).tolist()
    resolution = ACCUMULATED_RESOLUTION if setup.shadows.resolutions.by_power else None
    if setup.traced:
        batches = traced_batches(setup.shadows, lights, _most_layers(setup.size))
    else:
        batches = all_batches(setup.shadows, state.placed, lights, resolution)
    # What a catcher would have without shadows is the same for all passes.
    whole = wanted.light.cells() if MaterialKind.SHADOW_CATCHER in setup.kinds else lights
    unshadowed = _catcher_irradiance(setup, shown.pose, whole)
    near = all_near(setup, state, shown, _most_layers(setup.size))
    after = state._replace(maps=None, layers=None, coarse_layers=None, near_layers=None)
    return after, Lighting(lights, batches, (PixelSample(x, y, wanted.number),), unshadowed, bounce=setup.bounces, near=near)


def _in_time(setup: FrameSetup, state: FrameState, shown: FrameInput, lights: LightSet, costs: CostModel) -> tuple[FrameState, Lighting]:
    """As many lights, and as many redrawn maps or traced lights, as the target time allows."""
    surfaces_moved = not same_places(state.lookup_pose, shown.pose)
    budget = budget_of(setup, state, costs)._replace(surfaces_moved=surfaces_moved)
    budget = budget._replace(bounce=setup.bounces and bounce_affordable(budget))
    in_time = lights_in_time(state, shown, lights, budget, _most_layers(setup.size) if setup.traced else NEAR_BATCH)
    shown, lights = shown._replace(near=in_time.near), strongest_lights(lights, in_time.directional)
    if setup.traced:
        return _traced_in_time(setup, state._replace(bounce=budget.bounce), shown, lights, budget)
    coarser = coarsening(state.demand, state.coarsening, MAX_COARSENING)
    demand = state.demand if coarser == state.coarsening else state.demand._replace(backlog=1.0)
    halvings = halvings_by_id(setup.shadows, lights, coarser, state.halvings)
    state = state._replace(coarsening=coarser, demand=demand, halvings=halvings)

    maps = without_lookups(state.maps) if state.maps and surfaces_moved else state.maps
    near = near_mapped(setup, state, shown, budget, len(lights.ids))
    affordable = partial(affordable_maps, budget, len(lights.ids))
    cached = cached_batch(setup.shadows, state.placed, maps, lights, halvings, affordable)
    if cached is None:
        return _whole(setup, state, shown, lights)
    batch = cached.batch
    caches_visibility = setup.caches_visibility and not surfaces_moved and _visibility_cache_pays(setup.size, batch)
    near_work = len(near.batch.traced) * map_works(setup, near.batch.slots)
    summed = batch.every.count + len(near.batch.layers)
    work = FrameWork(batch.work + near_work, batch.unknown.count if caches_visibility else None, summed)
    if costs.frames >= WARM_UP_FRAMES:
        demand = updated_demand(demand, map_work(batch.resolutions), cached.stale_work, batch.work)
    maps = with_lookups(cached) if caches_visibility else cached.cache
    state = state._replace(demand=demand, maps=maps, lookup_pose=shown.pose, near_layers=near.kept(setup.samples))
    unshadowed = _catcher_irradiance(setup, shown.pose, lights)
    return state, Lighting(lights, (batch,), setup.samples, unshadowed, caches_visibility, work, near=near.drawn)


def _traced_in_time(
    setup: FrameSetup, state: FrameState, shown: FrameInput, lights: LightSet, budget: Budget
) -> tuple[FrameState, Lighting]:
    """These lights, of which as many are traced anew as the target time allows; all of them where surfaces moved or are seen anew.

    With `coarse` strong lights come as a batch on all pixels, weak ones as one on coarse pixels.
    """
    seen_anew = budget.surfaces_moved or len(setup.samples) > 1
    budget, rays = budget._replace(surfaces_moved=seen_anew), live_rays(lights)
    coarse = setup.coarse and lights.covariances is not None
    parts = [np.flatnonzero(rays != 1), np.flatnonzero(rays == 1)] if coarse else [np.arange(len(rays))]
    weights, kept = (1.0, COARSE_WEIGHT), (state.layers, state.coarse_layers)
    on_all = sum(weight * len(part) for weight, part in zip(weights, parts, strict=False))
    traced: list[TracedBatch] = []
    near = near_traced(setup, state, shown, lights, budget, on_all, _most_layers(setup.size))
    on_all += len(near.batch.layers)
    spent = near.batch.trace_work  # lights traced so far, as many on all pixels
    for weight, layers, part in zip(weights, kept, parts, strict=False):
        if layers and seen_anew:
            layers = TracedLayers.empty(len(layers.directions))
        affordable = partial(_affordable_part, budget, on_all, spent, weight)
        made = traced_batch(setup.shadows, layers, lights_of(lights, part), rays[part], _most_layers(setup.size), affordable)
        if made is None:
            return _whole(setup, state, shown, lights)
        traced.append(made._replace(batch=renumbered(made.batch, part)))
        spent += weight * made.batch.unknown.count
    demand, drawn = state.demand, sum(each.batch.every.count for each in traced)
    if budget.costs.frames >= WARM_UP_FRAMES:
        stale, anew = sum(each.stale for each in traced), sum(each.batch.unknown.count for each in traced)
        demand = updated_demand(demand, np.ones(drawn), np.ones(stale), anew)
    summed = sum(weight * each.batch.every.count for weight, each in zip(weights, traced, strict=False))
    work = FrameWork(0.0, spent, summed + len(near.batch.layers), budget.bounce)
    layers, coarse_layers = [*(each.layers for each in traced), None][:2] if len(setup.samples) == 1 else (None, None)
    weight = summed / drawn if drawn else state.light_weight
    state = state._replace(demand=demand, layers=layers, coarse_layers=coarse_layers, light_weight=weight, lookup_pose=shown.pose)
    state = state._replace(near_layers=near.kept(setup.samples))
    unshadowed, batches = _catcher_irradiance(setup, shown.pose, lights), tuple(each.batch for each in traced)
    return state, Lighting(lights, batches, setup.samples, unshadowed, work=work, bounce=budget.bounce, coarse=coarse, near=near.drawn)


def _affordable_part(budget: Budget, lights: float, spent: float, weight: float, stale: int) -> int:
    """How many stale lights of a weight can be traced where `lights` are summed and `spent` were traced, both as so many on all pixels."""
    most = affordable_traces(budget, lights, int(np.ceil(spent + weight * stale)))
    return min(int((most - spent) / weight), stale)


def _most_layers(size: tuple[int, int]) -> int:
    """How many layers of 8 bits a pixel fit the GPU's memory; one always does."""
    return max(MAX_CACHE_BYTES // (size[0] * size[1]), 1)


def _visibility_cache_pays(size: tuple[int, int], batch: Batch) -> bool:
    """Whether few enough maps are redrawn, and one layer of 8 bits a pixel for each map fits the GPU's memory."""
    return batch.redrawn.count <= MAX_REDRAWN * batch.every.count and max(batch.slots, 1) <= _most_layers(size)


def _catcher_irradiance(setup: FrameSetup, pose: ScenePose, lights: LightSet) -> Colour:
    """The irradiance that the lights give to the scene's catcher where no shadow falls, above 0 in each channel."""
    normal = setup.scene.shadow_catcher_normal(pose.matrices, pose.camera)
    if normal is None:
        return (1.0, 1.0, 1.0)
    fractions = received(lights.directions @ normal, Extents.of(lights))
    red, green, blue = np.maximum(fractions @ lights.irradiance, NO_LIGHT).tolist()
    return (red, green, blue)
