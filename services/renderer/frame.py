"""A frame as values: what all frames of a scene have in common, what one frame shows, what it leaves to the next, what is drawn.

frame_plan.py makes these, renderer.py draws them.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vemlight.choices import Tone
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.light.reflected_light import ReflectedLight
from vemlight.renderer.accumulation import MapLights
from vemlight.renderer.frame_budget import FrameWork, MapDemand
from vemlight.renderer.gl.constants import GLOSSY_KINDS, MaterialKind
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.renderer.pass_table import Pass
from vemlight.renderer.passes.lights.traced_lights import TracedLayers
from vemlight.renderer.passes.near_lights.near_light_plan import LitBy, NearBatch, NearLayers
from vemlight.renderer.passes.shadow_maps.casters import PlacedCasters
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch, MapCache, ShadowSetup
from vemlight.renderer.scene.materials import Colour
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose
from vemlight.renderer.scene.view import PixelSample

EDGE_SAMPLES = 8
NO_LIGHT = 1e-30  # irradiance in place of 0 where it divides; any value far below a star's and above float32's least, 1e-38, does
LIVE_SETS = 4  # of 16 rays each: the oldest is from a fifth of a second ago at 20 pictures a second


class FrameSetup(NamedTuple):
    """What all frames of a scene have in common. size: width, height in pixels. samples: of each pixel, which becomes their mean.

    target_ms: for a frame; 0: everything is drawn, however long it takes. kinds: of the scene's materials. rest: where the scene file
    puts everything. traced: whether shadows are by rays, not by maps. bounces: whether surfaces light each other. coarse: whether weak
    lights are summed on coarse pixels.
    """

    scene: Scene
    size: tuple[int, int]
    samples: tuple[PixelSample, ...]
    target_ms: float
    tone: Tone
    shadows: ShadowSetup
    kinds: frozenset[MaterialKind]
    emissive: bool
    rest: ScenePose
    traced: bool = False
    bounces: bool = False
    coarse: bool = False

    @property
    def glossy(self) -> bool:
        return bool(self.kinds & GLOSSY_KINDS)

    @property
    def edge_samples(self) -> int:
        """Samples of each pixel by which edges are smoothed, one a frame while nothing moves; 0 where the pixel itself has several, and
        where shadows are by maps."""
        return EDGE_SAMPLES if self.traced and self.target_ms > 0 and len(self.samples) == 1 else 0

    @property
    def bounce_sets(self) -> int:
        """In how many parts a bounce is gathered, one a frame where time counts."""
        return LIVE_SETS if self.target_ms > 0 else 1

    @property
    def caches_visibility(self) -> bool:
        """Lookups are cached for one sample in each pixel, and where that brings frames nearer to a target time."""
        return self.target_ms > 0 and len(self.samples) == 1 and not self.traced


class ToneRequest(NamedTuple):
    """A picture for a screen: the adaptation before it, the exposure on top, and the time in which the eye adapts to the picture.

    dt_s: seconds since `adaptation`; None: the eye does not adapt to this picture.
    """

    adaptation: Adaptation | None
    exposure_stops: float
    dt_s: float | None


class PlatePicture(NamedTuple):
    """A picture behind the scene, (h, w, 3) uint8 sRGB or float16 radiance, row 0 on top, made brighter by `stops`."""

    pixels: np.ndarray
    stops: float = 0.0


class AccumulationPass(NamedTuple):
    """Pass `number` of an accumulation under all the light of a map."""

    light: MapLights
    number: int


class FrameInput(NamedTuple):
    """What a frame shows. lights: the shadowed ones, or a pass of an accumulation.

    environment: the map that lobes reflect; None: they reflect the lights. background: a map that is seen behind the scene. plate: in place
    of the scene's; it hides the background. tone: for pixels. linear: whether the picture itself is wanted. near: lights that are near.
    """

    lights: LightSet | AccumulationPass
    pose: ScenePose
    environment: EnvironmentMap | None = None
    background: EnvironmentMap | None = None
    plate: PlatePicture | None = None
    tone: ToneRequest | None = None
    linear: bool = True
    near: NearLightSet = NearLightSet.empty()


class GBufferContents(NamedTuple):
    """Where the surfaces in the G-buffer stand, and the sample of each pixel at which they are seen."""

    pose: ScenePose
    sample: PixelSample


class FrameState(NamedTuple):
    """What a frame leaves to the next: choices with hysteresis, and what is cached on the GPU once the frame is drawn.

    placed: the casters. halvings: of each light's map, by the light's id. coarsening: halvings of all maps because time is short.
    bounce: whether there is time for the bounce. maps: cached shadow maps with their lookups; None where the next frame draws all. layers:
    of traced lights, likewise; coarse_layers: of those on coarse pixels; near_layers: of near ones. light_weight: what a light costs on
    average, over one on all pixels. gathered: under which lights each set of the bounce's rays was gathered, the newest last. edge_samples:
    of each pixel, by which edges are smoothed. lookup_pose: of the surfaces for which lookups may be cached or lights traced.
    luminaire_maps: where the scene stood when each luminaire's maps were drawn.
    """

    placed: PlacedCasters
    halvings: Mapping[int, int]
    coarsening: int
    demand: MapDemand
    bounce: bool
    maps: MapCache | None
    layers: TracedLayers | None
    coarse_layers: TracedLayers | None
    near_layers: NearLayers | None
    light_weight: float
    gathered: Mapping[int, LitBy]
    edge_samples: int
    lookup_pose: ScenePose | None
    g_buffer: GBufferContents | None
    luminaire_maps: tuple[ScenePose | None, ...]


class PassRun(NamedTuple):
    """A pass to run: for which batch of lights, and at which sample of each pixel."""

    row: Pass
    batch: int = 0
    sample: int = 0


class FramePlan(NamedTuple):
    """A frame to draw. before: what the GPU has cached, according to the state planned from; after: what it has then.

    passes: draw the picture, in their order; outputs: bring it to where it is wanted. unshadowed: irradiance of the catcher without
    shadows, above 0 in each channel. lights: those drawn. reflected: what lobes reflect of them and of the map. uploaded: a picture
    to show in place of drawing one. work: for the cost model; None: such a frame is not measured. near: batches of near lights. lit_by: all
    that are drawn.
    """

    shown: FrameInput
    before: FrameState
    after: FrameState
    passes: tuple[PassRun, ...]
    outputs: tuple[Pass, ...]
    batches: tuple[Batch, ...] = ()
    samples: tuple[PixelSample, ...] = ()
    unshadowed: Colour = (1.0, 1.0, 1.0)
    lights: LightSet = LightSet.none()
    reflected: ReflectedLight | None = None
    uploaded: np.ndarray | None = None
    work: FrameWork | None = None
    near: tuple[NearBatch, ...] = ()
    lit_by: LitBy = LitBy(LightSet.none(), NearLightSet.empty())

    @property
    def resolutions(self) -> np.ndarray:
        """Texels on a side of the shadow map that each light reads, (n,) int64."""
        return np.concatenate([np.zeros(0, np.int64), *(batch.resolutions for batch in self.batches)])

    @property
    def on_catchers(self) -> Colour:
        """Weight in the matte of catchers of a sample's light that is not among `lights`: it brightens what lies behind by its fraction
        of the light there."""
        red, green, blue = (-1 / (len(self.samples) * value) if value > NO_LIGHT else 0.0 for value in self.unshadowed)
        return red, green, blue

    def runs(self, row: Pass) -> bool:
        """Whether a pass is among those run."""
        return any(run.row is row for run in self.passes)
