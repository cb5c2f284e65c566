"""The gloss set: many lights without shadow maps of their own, for the lobes of glossy surfaces (Havran et al. 2005, section 4.2).

In a cone about the mirrored view the gloss set replaces the shadowed lights, with a soft rim: each set has the fraction of a lobe that the
other leaves. A light of the gloss set widens the lobe by its own spread, so that a mirror shows the light around and no dots. As normals
have light regions, mirrored views have regions with the lights that lie in any cone of theirs.
"""

from typing import NamedTuple

import moderngl
import numpy as np

from vemlight.light.light_set import LightSet
from vemlight.renderer.gl.buffers import GLOSS_GROUP, GLOSS_LIGHT, GLOSS_SPAN
from vemlight.renderer.gl.constants import GLOSSY_KINDS, MAX_LIGHTS, MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.lights.light_regions import CUBE_SIDE, light_regions
from vemlight.renderer.passes.lights.visibility_layers import VisibilityLayers
from vemlight.renderer.passes.shadow_maps.light_frames import LightFrames
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch
from vemlight.renderer.passes.shadow_maps.shadow_maps import ShadowAtlas

RIM = np.radians(20.0)  # of the cone, where the gloss set ends
CORE = np.radians(12.0)  # inside which it is alone
CONE = (float(np.cos(RIM)), float(np.cos(CORE)))
NO_CONE = (2.0, 3.0)  # cosines that no light reaches
REGIONS = 256  # of mirrored views: caps of 10 degrees, small beside a cone of 20 degrees
MAX_GLOSS_LIGHTS = 512  # of a region; of more, so many carry the irradiance of all
NEIGHBOURS = 4  # of a light, whose distance gives its spread: those of a square lattice


class GlossSet:
    """Adds the gloss set to the lobes of surfaces of the `kinds` of material."""

    def __init__(self, context: moderngl.Context, programs: Programs, kinds: set[MaterialKind], traced: bool) -> None:
        """traced: whether what arrives of a light is in a layer and not in its map."""
        self._context = context
        has = {f"HAS_{kind.name}": int(kind in kinds) for kind in GLOSSY_KINDS}
        self._program = programs.program("screen.vert", "gloss.frag", CACHED_VISIBILITY=int(traced), **has)
        self._array = context.vertex_array(self._program, [])
        self._regions = light_regions(REGIONS)
        self._cube = context.texture_cube((CUBE_SIDE, CUBE_SIDE), 1, self._regions.cube.astype(np.float32).tobytes(), dtype="f4")
        self._cube.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._buffers = [context.buffer(reserve=struct.dtype.itemsize, dynamic=True) for struct in (GLOSS_SPAN, GLOSS_GROUP, GLOSS_LIGHT)]
        self._program["cone"] = CONE

    def gather(self, gloss_set: LightSet, batch: Batch) -> None:
        """Uploads the gloss set, each light shadowed by the nearest of a batch's lights; there must be some of either."""
        shadowed = batch.of(batch.every)["direction"]
        lit = np.flatnonzero(np.any(gloss_set.irradiance != 0, axis=1))
        nearest = np.argmax(gloss_set.directions[lit] @ shadowed.T, axis=1)
        reach = self._regions.reach + RIM
        rows = gloss_rows(self._regions.centres, reach, gloss_set.directions[lit], gloss_set.irradiance[lit], nearest)
        for buffer, table in zip(self._buffers, rows, strict=True):
            if buffer.size < table.nbytes:
                buffer.orphan(table.nbytes)
            buffer.write(table.tobytes())

    def add(
        self,
        g_buffer: GBuffer,
        frames: LightFrames,
        arriving: ShadowAtlas | VisibilityLayers,
        batch: Batch,
        picture: moderngl.Framebuffer,
        weight: float,
    ) -> None:
        """Adds the gloss set times `weight` to a picture. arriving: what says how much of each light of the batch arrives."""
        unit = g_buffer.bind(self._program)
        arriving.bind(self._program, unit)
        frames.bind_row(batch.every)
        self._cube.use(unit + 1)
        self._program["region_of_direction"] = unit + 1
        for binding, buffer in enumerate(self._buffers, 1):
            buffer.bind_to_storage_buffer(binding)
        self._program["weight"] = weight
        picture.use()
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (self._array, self._cube, *self._buffers):
            resource.release()


class GlossRows(NamedTuple):
    """The gloss set as gloss.frag reads it: spans (n,) GLOSS_SPAN of each region, groups (g,) GLOSS_GROUP, lights (k,) GLOSS_LIGHT."""

    spans: np.ndarray
    groups: np.ndarray
    lights: np.ndarray


def gloss_rows(centres: np.ndarray, reach: np.ndarray, directions: np.ndarray, irradiance: np.ndarray, nearest: np.ndarray) -> GlossRows:
    """The lights (m, 3) within `reach` (n,) rad of each region's centre (n, 3), each with the number of its shadowed light (m,).

    Of more than MAX_GLOSS_LIGHTS in a region the first are taken, in the order of powers of two of their irradiance and then of the set.
    Those like the last of them carry the irradiance of the rest, in each channel. So lights of like power stay in the progressive order
    and are scaled alike, and a sun stays what it is.
    """
    power = irradiance.max(axis=1)
    level = np.floor(np.log2(np.maximum(power / power.mean(), 1e-6)) + 0.5)
    order = np.argsort(-level, kind="stable")
    lights = np.zeros(len(order), GLOSS_LIGHT.dtype)
    lights["direction"], lights["irradiance"] = directions[order], irradiance[order]
    lights["spread_squared"] = spread(directions[order]) ** 2
    irradiance, level, nearest = irradiance[order], level[order], nearest[order]
    region, light = np.nonzero(centres @ directions[order].T >= np.cos(np.minimum(reach, np.pi))[:, None])
    first = np.searchsorted(region, np.arange(len(centres)))
    taken = np.arange(len(region)) - first[region] < MAX_GLOSS_LIGHTS
    rows = lights[light[taken]]
    if not taken.all():
        last = level[light[np.minimum(first + MAX_GLOSS_LIGHTS, len(light)) - 1]]  # of each full region
        alike = level[light] <= last[region] + 1
        rest = _sums(region[~taken], irradiance[light[~taken]], len(centres))
        carrying = _sums(region[taken & alike], irradiance[light[taken & alike]], len(centres))
        scale = 1 + np.divide(rest, carrying, out=np.zeros_like(rest), where=carrying > 0)
        rows["irradiance"][alike[taken]] *= scale[region[taken & alike]]
    keys = region[taken] * MAX_LIGHTS + nearest[light[taken]]
    grouped = np.argsort(keys, kind="stable")
    found, first, counts = np.unique(keys[grouped], return_index=True, return_counts=True)
    groups = np.zeros(len(found), GLOSS_GROUP.dtype)
    groups["shadowing"], groups["first"], groups["count"] = found % MAX_LIGHTS, first, counts
    spans = np.zeros(len(centres), GLOSS_SPAN.dtype)
    spans["count"] = np.bincount(found // MAX_LIGHTS, minlength=len(centres))
    spans["first"] = np.cumsum(spans["count"]) - spans["count"]
    return GlossRows(spans, groups, rows[grouped])


def spread(directions: np.ndarray) -> np.ndarray:
    """The radius, in rad, of the disc that each light of the directions (m, 3) stands for, (m,) float64.

    Half the diagonal of a square cell whose neighbours are as far as the NEIGHBOURS nearest lights; 0 where there are no more than those.
    """
    if len(directions) <= NEIGHBOURS:
        return np.zeros(len(directions))
    from scipy.spatial import KDTree  # here, since it takes a third of a second to load

    return KDTree(directions).query(directions, NEIGHBOURS + 1)[0][:, 1:].mean(axis=1) / np.sqrt(2)


def _sums(group: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, 3) of values (k, 3) by their group."""
    return np.stack([np.bincount(group, values[:, c], count) for c in range(3)], axis=-1, dtype=np.float64)
