"""The fraction of each light that reaches each pixel, by shadow rays on the processor, from the surfaces in the G-buffer.

Exact at every distance and for every caster, where a map has texels. On a machine without a graphics card the rays of a light cost about
as much as its map and the lookups in it; on one with a card maps are far cheaper. Which lights a frame traces, its plan says.
"""

from collections.abc import Iterator

import moderngl
import numpy as np

from vemlight.light.extent import Extents
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.gl.constants import MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.bounce.bounce import BounceLight
from vemlight.renderer.passes.edges.edges import Edges
from vemlight.renderer.passes.gbuffer.coarse_surfaces import CoarseSurfaces
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.lights.visibility_layers import VisibilityLayers
from vemlight.renderer.passes.mirrors.mirrors import Mirrors
from vemlight.renderer.passes.near_lights.near_light_plan import near_of
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch
from vemlight.renderer.rays.sampled_tracing import Settled, trace_first, trace_next
from vemlight.renderer.rays.sampled_tracing import warm as warm_samples
from vemlight.renderer.rays.soft_pattern import soft_pattern
from vemlight.renderer.rays.tracing import RayTracer, TracedLights
from vemlight.renderer.scene.scene import Scene

GOLDEN = (np.sqrt(5) - 1) / 2  # multiples of it are evenly spread around a turn
MAX_TRACED_BYTES = 2**26  # of layers traced together, before they are uploaded; any value from 2^24 to 2^28 does


class TracedVisibility:
    """Traces lights into layers for pictures of `size` pixels (width, height) of a scene."""

    def __init__(self, scene: Scene, size: tuple[int, int], layers: VisibilityLayers, beside: "TracedVisibility | None" = None) -> None:
        """beside: for the same scene at another size, whose triangles this uses."""
        self._tracer, self._size, self._layers = RayTracer(scene, size, beside and beside._tracer), size, layers
        self._settled: dict[int, Settled] = {}  # by the first sample, of the lights from a number on

    def coarse(self, scene: Scene, size: tuple[int, int], layers: VisibilityLayers) -> "TracedVisibility":
        """What traces for the same scene at another size."""
        return TracedVisibility(scene, size, layers, self)

    def edges(self, context: moderngl.Context, programs: Programs) -> Edges:
        """What smooths the edges of the surfaces that this sees."""
        return Edges(context, programs, self._size, self._tracer)

    def bounce(self, context: moderngl.Context, programs: Programs, scene: Scene, sets: int) -> BounceLight:
        """What gathers a bounce on the surfaces that this sees."""
        return BounceLight(context, programs, scene, self._size, self._tracer, sets)

    def mirrors(self, context: moderngl.Context, programs: Programs, scene: Scene, kinds: set[MaterialKind], live: bool) -> Mirrors:
        """What finds what the polished ones of the surfaces that this sees reflect of the scene."""
        return Mirrors(context, programs, scene, self._size, kinds, self._tracer, live)

    def place(self, matrices: np.ndarray) -> None:
        """Moves the meshes: world_from_rest (n, 4, 4)."""
        self._tracer.place(matrices)

    def see(self, g_buffer: GBuffer | CoarseSurfaces) -> None:
        """Takes the surfaces that were drawn last."""
        self._tracer.see(*g_buffer.read_surfaces())

    def trace(self, batch: Batch, sample: int, samples: int, whole: bool) -> None:
        """Traces those lights of a batch that its plan says, from a sample of each pixel's `samples`. whole: as RayTracer.trace has it."""
        texture = self._layers.make_room(max(batch.slots, 1))
        layers = batch.of(batch.unknown)["map"].astype(int).tolist()
        lights = traced_lights(batch.traced, batch.rays)
        width, height = self._size
        together = max(MAX_TRACED_BYTES // (width * height), 1)
        for first in range(0, len(layers), together):
            part = TracedLights(*(each[first : first + together] for each in lights))
            arriving = self._trace(part, sample, samples, first) if samples > 1 else self._tracer.trace(part, soft_pattern(0, 1), whole)
            for own, layer in zip(arriving, layers[first : first + together], strict=True):
                texture.write(own.data, viewport=(0, 0, layer, width, height, 1), alignment=1)

    def _trace(self, lights: TracedLights, sample: int, samples: int, number: int) -> np.ndarray:
        """Traces lights, from a number of their batch on, at one of several samples; the first comes first."""
        if sample:
            return trace_next(self._tracer, lights, sample, samples, self._settled[number])
        arriving, self._settled[number] = trace_first(self._tracer, lights, samples)
        return arriving

    def near(self, lights: NearLightSet, sample: int, samples: int, whole: bool) -> Iterator[np.ndarray]:
        """The fraction (height, width) uint8 of each near light that arrives, one after the other; the others as `trace` has them."""
        from vemlight.renderer.rays.near_tracing import trace_near  # here, since most pictures do without this kernel

        together = max(MAX_TRACED_BYTES // (self._size[0] * self._size[1]), 1)
        for first in range(0, len(lights.ids), together):
            part = np.arange(first, min(first + together, len(lights.ids)))
            yield from trace_near(self._tracer, near_of(lights, part), sample, samples, whole)

    def warm(self, near: bool, samples: int) -> None:
        """Compiles, or loads, what a picture of so many samples needs; near: one with near lights."""
        self._tracer.warm()
        if samples > 1:
            warm_samples(self._tracer)
        if near:
            from vemlight.renderer.rays.near_tracing import warm

            warm(self._tracer)

    def release(self) -> None:
        """Frees what the rays need."""
        self._tracer.release()


def traced_lights(lights: LightSet, rays: np.ndarray) -> TracedLights:
    """Lights as rays see them. Each turns the pattern by its id, so that the lights' patterns average out."""
    axes = Extents.of(lights).axes
    turn = 2 * np.pi * (lights.ids * GOLDEN % 1.0)
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    turned = [cos * axes[:, 0] + sin * axes[:, 1], cos * axes[:, 1] - sin * axes[:, 0]]
    return TracedLights(np.ascontiguousarray(lights.directions), np.stack(turned, axis=1).astype(np.float32), rays)
