"""What surfaces send to each other, as passes of a frame: the bounce, and what polished surfaces show of the scene."""

from typing import TYPE_CHECKING

import moderngl
import numpy as np

from vemlight.renderer import pass_table
from vemlight.renderer.frame import FramePlan, FrameSetup, PassRun
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.lights.shading import Shading

if TYPE_CHECKING:
    from vemlight.renderer.passes.lights.traced_visibility import TracedVisibility
    from vemlight.renderer.passes.lights.weak_lights import WeakLights


class Interreflection:
    """Of the surfaces in a G-buffer, for the pictures of a `Shading`. rays: that find it; None: there is none."""

    def __init__(
        self,
        context: moderngl.Context,
        programs: Programs,
        setup: FrameSetup,
        rays: "TracedVisibility | None",
        g_buffer: GBuffer,
        shading: Shading,
    ) -> None:
        self._setup, self._g_buffer, self._shading = setup, g_buffer, shading
        self._bounce = self._mirrors = None
        if rays and setup.bounces:
            self._bounce = rays.bounce(context, programs, setup.scene, setup.bounce_sets)
            if setup.glossy:
                self._mirrors = rays.mirrors(context, programs, setup.scene, set(setup.kinds), setup.target_ms > 0)

    def warm(self) -> None:
        """Compiles, or loads, what this needs; the rays have seen surfaces."""
        for part in (self._bounce, self._mirrors):
            if part:
                part.warm()

    def add_bounce(self, plan: FramePlan, run: PassRun) -> None:
        """Adds what surfaces send to each other; all samples of a pixel have what was gathered at the first."""
        assert self._bounce
        if run.sample == 0:
            self._gather(plan)
        weight = 1 / len(plan.samples)
        self._bounce.add(self._g_buffer, self._shading.frame, (weight, weight, weight))
        self._add_on_catchers(plan)

    def add_weak_bounce(self, plan: FramePlan, lights: "WeakLights") -> None:
        """Adds it to the coarse pixels of weak lights, and to the matte of catchers."""
        assert self._bounce
        self._gather(plan)
        lights.add_bounce(self._bounce)
        self._add_on_catchers(plan)

    def add_mirrors(self, plan: FramePlan, run: PassRun) -> None:
        """Adds what polished surfaces show of the scene."""
        assert self._mirrors
        self._mirrors.trace(self._g_buffer, plan.samples[run.sample].number, plan.lit_by, self._catcher_normal(plan))
        self._mirrors.add(self._g_buffer, self._shading.frame, 1 / len(plan.samples))

    def mirrored(self, plan: FramePlan) -> moderngl.Texture | None:
        """What polished surfaces show of the scene in this frame, and how much of their lobes meets it."""
        return self._mirrors.scene if self._mirrors and plan.runs(pass_table.MIRRORS) else None

    def _gather(self, plan: FramePlan) -> None:
        assert self._bounce
        self._bounce.gather(plan.after.gathered, self._catcher_normal(plan), self._g_buffer.rays.eye)

    def _add_on_catchers(self, plan: FramePlan) -> None:
        if self._bounce and self._shading.matte_frame:
            self._bounce.add(self._g_buffer, self._shading.matte_frame, plan.on_catchers, catchers=True)

    def _catcher_normal(self, plan: FramePlan) -> np.ndarray | None:
        pose = plan.shown.pose
        return self._setup.scene.shadow_catcher_normal(pose.matrices, pose.camera)

    def release(self) -> None:
        """Frees what this holds."""
        for part in (self._bounce, self._mirrors):
            if part:
                part.release()
