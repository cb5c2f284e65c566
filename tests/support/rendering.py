"""Pictures of a scene, one after the other, without the stage around them."""

from collections.abc import Iterable

import numpy as np

from vemlight import settings
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.accumulation import MapLights
from vemlight.renderer.frame import AccumulationPass, FrameInput, PlatePicture, ToneRequest
from vemlight.renderer.frame_plan import plan_upload
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.renderer.renderer import DrawnFrame, Renderer
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import scene_pose
from vemlight.runtime.poses import Pose


class SceneRenderer(FrameSequence):
    """A sequence of frames in which what stays the same need not be repeated."""

    def __init__(self, scene: Scene, settings: settings.Renderer, samples: int = 1, timed: bool = False) -> None:
        super().__init__(Renderer(scene, settings, samples, timed))
        self.pose = self.renderer.setup.rest
        self.background: EnvironmentMap | None = None
        self.plate: PlatePicture | None = None
        self.near = NearLightSet.empty()

    def place(self, time_s: float, poses: Iterable[Pose] = ()) -> tuple[Pose, ...]:
        """Moves the scene before the next picture; where its objects and lamps then are."""
        self.pose = scene_pose(self.renderer.setup.scene, time_s, poses)
        return self.pose.objects

    def frame(
        self, lights: LightSet | AccumulationPass, environment: EnvironmentMap | None = None, tone: ToneRequest | None = None
    ) -> DrawnFrame:
        return self.draw(FrameInput(lights, self.pose, environment, self.background, self.plate, tone, near=self.near))

    def picture(self, lights: LightSet | AccumulationPass, environment: EnvironmentMap | None = None) -> np.ndarray:
        """(height, width, 4) float32, linear."""
        picture = self.frame(lights, environment).picture
        assert picture is not None
        return picture

    def picture_of_pass(self, light: MapLights, number: int) -> np.ndarray:
        """The picture of a pass of an accumulation."""
        return self.picture(AccumulationPass(light, number))

    def tone_mapped(self, picture: np.ndarray, adaptation: Adaptation, exposure_stops: float) -> np.ndarray:
        """A picture tone-mapped on the GPU, (height, width, 4) uint8."""
        shown = FrameInput(LightSet.none(), self.pose, tone=ToneRequest(adaptation, exposure_stops, None), linear=False)
        pixels = self.renderer.draw(plan_upload(self.state, picture, shown)).pixels
        assert pixels is not None
        return pixels
