"""The renderer as a stage of the pipeline: lights in, pictures out, and the pictures' files."""

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from services import settings, wire
from services.channels import Service
from services.lights import Lights
from services.renderer.album import Album
from services.renderer.renderer import Renderer
from services.renderer.scene import load_scene
from services.renderer.tonemap import Adaptation, adapt

FILE_SAMPLES = 4  # a pixel of a file is the average over its area
LIVE_SAMPLES = 1


class RendererState(NamedTuple):
    """What the tone mapping remembers, the exposure wanted, and the picture just made."""

    exposure: float  # stops
    adaptation: Adaptation | None
    time_s: float
    picture: np.ndarray | None  # (height, width, 4) float32, linear


class RendererStage:
    """See `services.loop.Stage`."""

    service: Service = "renderer"

    def __init__(self, settings: settings.Settings) -> None:
        """Raises BadInput for a scene that cannot be read, a machine without GL, a folder that cannot be written."""
        scene = load_scene(Path(settings.renderer.scene) if settings.renderer.scene else None)
        self.beside: tuple[Service, ...] = ("plate",) if settings.plate.source else ()
        self._exposure = settings.renderer.exposure
        self._album = Album(Path(settings.out)) if settings.out else None
        self._renderer = Renderer(scene, settings.renderer, FILE_SAMPLES if self._album else LIVE_SAMPLES)

    def kept(self) -> int:
        return self._album.count if self._album else 0

    def begin(self, target: int) -> tuple[RendererState, int]:
        """At the target itself: what the tone mapping remembered stands beside the picture before it."""
        before = self._album.last if self._album and target else None
        return RendererState(self._exposure, before and before.adaptation, before.time_s if before else 0.0, None), target

    def step(self, state: RendererState, message: wire.Message) -> tuple[RendererState, wire.Message]:
        header, arrays = message
        assert isinstance(header, wire.Lights)
        began_s = time.monotonic()
        picture = self._renderer.render(Lights(*arrays[:3]))
        adaptation = adapt(state.adaptation, picture, max(0.0, header.stamp.time_s - state.time_s))
        pixels = self._renderer.tone_mapped(adaptation, state.exposure)
        height, width, _ = pixels.shape
        took_ms = (time.monotonic() - began_s) * 1e3
        made = wire.Image(stamp=header.stamp, width=width, height=height, lights=header.count, render_ms=took_ms)
        return RendererState(state.exposure, adaptation, header.stamp.time_s, picture), (made, (pixels,))

    def heed(self, state: RendererState, said: wire.Message) -> RendererState:
        header, _ = said
        if isinstance(header, wire.Control):
            return state._replace(exposure=self._exposure if header.exposure is None else header.exposure)
        return state

    def keep(self, state: RendererState, message: wire.Message) -> None:
        header, (pixels,) = message
        if self._album and state.picture is not None and state.adaptation is not None and isinstance(header, wire.Image):
            self._album.add(state.picture, pixels, header.stamp, state.adaptation)

    def done(self) -> None:
        if self._album:
            self._album.write_contact_sheet()
