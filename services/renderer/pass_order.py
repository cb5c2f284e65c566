"""Which passes draw a frame, and in which order."""

from typing import NamedTuple

from vemlight.light.light_set import LightSet
from vemlight.light.reflected_light import ReflectedLight
from vemlight.renderer import pass_table
from vemlight.renderer.frame import FrameInput, FrameSetup, GBufferContents, PassRun
from vemlight.renderer.frame_budget import FrameWork
from vemlight.renderer.gl.constants import MaterialKind
from vemlight.renderer.near_planning import near_passes
from vemlight.renderer.pass_table import Pass
from vemlight.renderer.passes.near_lights.near_light_plan import NearBatch
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch
from vemlight.renderer.scene.materials import Colour
from vemlight.renderer.scene.scene_pose import same_places
from vemlight.renderer.scene.view import PixelSample


class Lighting(NamedTuple):
    """How a frame sums its lights; fields as in FramePlan. caches_visibility: whether lookups go through the visibility cache. bounce:
    whether surfaces light each other. coarse: whether the last batch is summed on coarse pixels. near: batches of near lights.
    """

    lights: LightSet
    batches: tuple[Batch, ...]
    samples: tuple[PixelSample, ...]
    unshadowed: Colour
    caches_visibility: bool = False
    work: FrameWork | None = None
    bounce: bool = False
    coarse: bool = False
    near: tuple[NearBatch, ...] = ()


def drawing_passes(
    setup: FrameSetup,
    g_buffer: GBufferContents | None,
    shown: FrameInput,
    lighting: Lighting,
    reflected: ReflectedLight | None,
    luminaires_stale: bool,
) -> tuple[list[PassRun], GBufferContents | None]:
    """The passes that draw the picture, in their order, and what the G-buffer holds after them."""
    runs = [PassRun(pass_table.LUMINAIRE_MAPS)] if luminaires_stale else []
    glossy = reflected is not None and reflected.radiance is not None
    for number in range(1 if lighting.coarse else len(lighting.batches)):
        first = number == 0  # what does not depend on the batch is drawn with the first
        if not setup.traced:
            runs.append(PassRun(pass_table.SHADOW_MAPS, number))
        if glossy and first:
            runs.append(PassRun(pass_table.PREFILTER, number))
        for k, sample in enumerate(lighting.samples):
            rows = []
            if g_buffer is None or g_buffer.sample != sample or not same_places(g_buffer.pose, shown.pose):
                g_buffer = GBufferContents(shown.pose, sample)
                rows += [pass_table.G_BUFFER, *[pass_table.COARSE_SURFACES] * setup.coarse, pass_table.CLASSES]
            if first and setup.emissive:
                rows.append(pass_table.EMISSION)
            if first and setup.scene.luminaires:
                rows.append(pass_table.LUMINAIRES)
            if lighting.coarse:
                runs += [PassRun(row) for row in rows]
                runs += [PassRun(row, 1) for row in _of_coarse_pixels(lighting.bounce, glossy)]
                rows = []
            if setup.traced:
                rows.append(pass_table.RAYS)
            elif lighting.caches_visibility:
                rows.append(pass_table.VISIBILITY_CACHE)
            rows.append(pass_table.LIGHTS)
            if first:
                runs += [PassRun(row, number, k) for row in rows]
                runs += [PassRun(row, own, k) for own in range(len(lighting.near)) for row in near_passes(setup)]
                rows = []
            if setup.bounces and first and setup.glossy:  # also where time leaves no bounce: half of a mirror would be black
                rows.append(pass_table.MIRRORS)
            if glossy and first:
                rows.append(pass_table.GLOSS)
            if lighting.bounce and first and not lighting.coarse:
                rows.append(pass_table.BOUNCE)
            runs += [PassRun(row, number, k) for row in rows]
    if lighting.near and MaterialKind.SHADOW_CATCHER in setup.kinds:
        runs.append(PassRun(pass_table.NEAR_MATTE))
    if shown.background or shown.plate or setup.scene.plate is not None:
        runs.append(PassRun(pass_table.COMPOSITING))
    return runs, g_buffer


def _of_coarse_pixels(bounce: bool, glossy: bool) -> list[Pass]:
    """The passes over coarse pixels, before the others take what these have received."""
    rows = [pass_table.WEAK_RAYS, pass_table.WEAK_LIGHTS]
    return rows + [pass_table.WEAK_BOUNCE] * bounce + [pass_table.WEAK_GLOSS] * glossy


def output_passes(shown: FrameInput) -> tuple[Pass, ...]:
    """The passes that bring a picture to where it is wanted."""
    rows = [pass_table.READ_BACK] if shown.linear else []
    if shown.tone and shown.tone.dt_s is not None:
        rows.append(pass_table.ADAPTATION)
    if shown.tone:
        rows.append(pass_table.TONE_MAPPING)
    return tuple(rows)
