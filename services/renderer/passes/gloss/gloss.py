"""The second set of lights, many and weak, for the lobes of glossy surfaces (Havran et al. 2005, section 4.2).

In a cone about the mirrored view the weak lights stand in for the strong ones, with a soft rim: each set has the share of a lobe that the
other leaves. A weak light widens the lobe by its own spread, so that a mirror shows the light around and no dots. As normals have light
regions, mirrored views have regions with the weak lights that lie in any cone of theirs.
"""

from typing import NamedTuple

import moderngl
import numpy as np
from scipy.spatial import KDTree

from vemlight.light.light_set import LightSet
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import Surfaces
from vemlight.renderer.passes.lights.light_regions import CUBE_SIDE, light_regions
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import MAX_LIGHTS, Batch
from vemlight.renderer.passes.shadow_maps.shadow_maps import ShadowAtlas
from vemlight.renderer.scene.materials import MaterialKind

RIM = np.radians(20.0)  # of the cone, where the weak lights end
CORE = np.radians(12.0)  # where they are alone
CONE = (float(np.cos(RIM)), float(np.cos(CORE)))
NO_CONE = (2.0, 3.0)  # cosines that no light reaches
REGIONS = 256  # of mirrored views: caps of 10 degrees, beside a cone of 20 degrees
MOST = 512  # weak lights of a region; of more, so many carry what the others had
LINE = 1024  # groups or lights in a line of the texture that holds them: a power of two, since a pixel divides by it for each light
NEIGHBOURS = 4  # of a light, whose distance tells its spread


class Gloss:
    """Adds the weak lights to a picture of `surfaces`, which have the `kinds` of material."""

    def __init__(self, context: moderngl.Context, programs: Programs, kinds: set[MaterialKind]) -> None:
        self._context = context
        named = {"MAX_LIGHTS": MAX_LIGHTS, "LINE": LINE, "PHONG": int(MaterialKind.PHONG in kinds), "GGX": int(MaterialKind.GGX in kinds)}
        self._program = programs.program("screen.vert", "gloss.frag", **{name: str(value) for name, value in named.items()})
        self._array = context.vertex_array(self._program, [])
        self._regions = light_regions(REGIONS)
        self._cube = context.texture_cube((CUBE_SIDE, CUBE_SIDE), 1, self._regions.cube.astype(np.float32).tobytes(), dtype="f4")
        self._cube.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._spans = context.texture((REGIONS, 1), 2, dtype="f4")
        lines = REGIONS * MOST // LINE
        self._groups, self._lights = context.texture((LINE, lines), 4, dtype="f4"), context.texture((2 * LINE, lines), 4, dtype="f4")
        for texture in (self._spans, self._groups, self._lights):
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._program["cone"] = CONE

    def gather(self, weak: LightSet, batch: Batch) -> None:
        """Uploads the weak lights, each shadowed by the nearest of a batch's strong lights; there must be some of either."""
        strong = batch.of(batch.every)[:, 0:3]
        lit = np.flatnonzero(np.any(weak.irradiance != 0, axis=1))
        nearest = np.argmax(weak.directions[lit] @ strong.T, axis=1)
        rows = weak_rows(self._regions.centres, self._regions.reach + RIM, weak.directions[lit], weak.irradiance[lit], nearest)
        self._spans.write(rows.spans.tobytes())
        for texture, table in ((self._groups, rows.groups), (self._lights, rows.lights)):
            lines = -(-len(table) // LINE)
            whole = np.zeros((lines * LINE, *table.shape[1:]), np.float32)
            whole[: len(table)] = table
            texture.write(whole.tobytes(), viewport=(0, 0, texture.width, lines))

    def add(self, surfaces: Surfaces, atlas: ShadowAtlas, batch: Batch, frame: moderngl.Framebuffer, weight: float) -> None:
        """Adds the weak lights times `weight` to the picture in `frame`; the maps of the batch are in the atlas."""
        unit = surfaces.bind(self._program)
        atlas.bind(self._program, unit)
        atlas.bind_row(batch.every)
        textures = {"region_of_direction": self._cube, "spans": self._spans, "groups": self._groups, "weak_lights": self._lights}
        for number, (name, texture) in enumerate(textures.items(), unit + 1):
            texture.use(number)
            self._program[name] = number
        self._program["weight"] = weight
        frame.use()
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for thing in (self._array, self._cube, self._spans, self._groups, self._lights):
            thing.release()


class WeakRows(NamedTuple):
    """The weak lights of all regions, float32, as gloss.frag reads them.

    spans: (n, 2), of each region its first group and how many. groups: (g, 4), the number of the strong light whose shadow they share, the
    first light, how many, 0. lights: (k, 2, 4), direction and 0, then irradiance and the square of the spread.
    """

    spans: np.ndarray
    groups: np.ndarray
    lights: np.ndarray


def weak_rows(centres: np.ndarray, reach: np.ndarray, directions: np.ndarray, irradiance: np.ndarray, strong: np.ndarray) -> WeakRows:
    """The weak lights (m, 3) within `reach` (n,) rad of each region's centre (n, 3), each with the number of its strong light (m,).

    Of more than MOST in a region the first are kept, who is stronger by a power of two before the others and then in the order of the
    set, and those like the last of them carry what the others had, in each channel. So lights of like power keep the progressive order
    and are scaled alike, and a sun stays what it is.
    """
    power = irradiance.max(axis=1)
    level = np.floor(np.log2(np.maximum(power / power.mean(), 1e-6)) + 0.5)
    order = np.argsort(-level, kind="stable")
    lights = np.empty((len(order), 2, 4), np.float32)
    lights[:, 0, :3], lights[:, 0, 3] = directions[order], 0.0
    lights[:, 1, :3], lights[:, 1, 3] = irradiance[order], spread(directions[order]) ** 2
    irradiance, level, strong = irradiance[order], level[order], strong[order]
    region, light = np.nonzero(centres @ directions[order].T >= np.cos(np.minimum(reach, np.pi))[:, None])
    first = np.searchsorted(region, np.arange(len(centres)))
    kept = np.arange(len(region)) - first[region] < MOST
    rows = lights[light[kept]]
    if not kept.all():
        last = level[light[np.minimum(first + MOST, len(light)) - 1]]  # of each full region
        alike = level[light] <= last[region] + 1
        left = _sums(region[~kept], irradiance[light[~kept]], len(centres))
        carrying = _sums(region[kept & alike], irradiance[light[kept & alike]], len(centres))
        scale = 1 + np.divide(left, carrying, out=np.zeros_like(left), where=carrying > 0)
        rows[alike[kept], 1, :3] *= scale[region[kept & alike]]
    keys = region[kept] * MAX_LIGHTS + strong[light[kept]]
    grouped = np.argsort(keys, kind="stable")
    found, first, sizes = np.unique(keys[grouped], return_index=True, return_counts=True)
    groups = np.stack([found % MAX_LIGHTS, first, sizes, np.zeros(len(found))], axis=-1)
    counts = np.bincount(found // MAX_LIGHTS, minlength=len(centres))
    spans = np.stack([np.cumsum(counts) - counts, counts], axis=-1)
    return WeakRows(spans.astype(np.float32), groups.astype(np.float32), rows[grouped])


def spread(directions: np.ndarray) -> np.ndarray:
    """About how far, in rad, the light that each of the directions (m, 3) stands for reaches around it, (m,) float64.

    Half the diagonal of a square cell whose neighbours are as far as the NEIGHBOURS nearest lights; 0 where there are no more than those.
    """
    if len(directions) <= NEIGHBOURS:
        return np.zeros(len(directions))
    return KDTree(directions).query(directions, NEIGHBOURS + 1)[0][:, 1:].mean(axis=1) / np.sqrt(2)


def _sums(group: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, 3) of values (k, 3) by their group."""
    return np.stack([np.bincount(group, values[:, c], count) for c in range(3)], axis=-1, dtype=np.float64)
