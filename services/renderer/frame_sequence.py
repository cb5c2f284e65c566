"""Frames of one scene, one after the other, for a caller that holds no state itself."""

import numpy as np

from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.frame import FrameInput, FramePlan
from vemlight.renderer.frame_budget import CostModel, FrameTimings, updated_costs
from vemlight.renderer.frame_plan import initial_state, plan
from vemlight.renderer.renderer import DrawnFrame, Renderer
from vemlight.renderer.scene.scene_pose import ScenePose


class FrameSequence:
    """Carries state and costs from each frame to the next. plan, timings: of the last frame."""

    plan: FramePlan
    timings: FrameTimings

    def __init__(self, renderer: Renderer) -> None:
        self.renderer, self.costs = renderer, CostModel()
        self.state = initial_state(renderer.setup)

    def draw(self, shown: FrameInput) -> DrawnFrame:
        """Plans and draws a frame."""
        self.plan, self.state = plan(self.renderer.setup, self.state, shown, self.costs)
        drawn = self.renderer.draw(self.plan)
        self.timings = drawn.timings
        if self.plan.work:
            self.costs = updated_costs(self.costs, self.plan.work, drawn.timings)
        return drawn

    def render(
        self,
        lights: LightSet,
        environment: EnvironmentMap | None = None,
        pose: ScenePose | None = None,
        background: EnvironmentMap | None = None,
        near: NearLightSet | None = None,
    ) -> np.ndarray:
        """The picture under these lights, as DrawnFrame has it; without a pose, where the scene file puts everything.

        environment: that lobes reflect; without one, they reflect the lights.
        """
        shown = FrameInput(lights, pose or self.renderer.setup.rest, environment, background, near=near or NearLightSet.empty())
        picture = self.draw(shown).picture
        assert picture is not None
        return picture

    def release(self) -> None:
        """Frees everything on the GPU."""
        self.renderer.release()
