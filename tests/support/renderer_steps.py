"""Single steps of the renderer's stage: a lights message in, an image message out."""

import numpy as np

from tests.support.light_sets import uniform_lights
from vemlight.renderer.stage import RendererStage, RendererState
from vemlight.runtime import stamps, wire


def lights_message(sequence: int, fps: float = 10.0) -> wire.Message:
    lights = uniform_lights(3, 0.0)
    none = np.zeros((0, 3), np.float32)
    header = wire.LightsMessage(stamp=stamps.stamp(sequence, sequence / fps), count=3, coverage="hemisphere")
    return header, (lights.ids, lights.directions, lights.irradiance, none, none)


def stepped(stage: RendererStage, state: RendererState, sequence: int) -> tuple[RendererState, wire.ImageMessage]:
    """The state after one lights message and the header of its image."""
    state, (header, arrays) = stage.step(state, lights_message(sequence))
    assert isinstance(header, wire.ImageMessage)
    assert wire.unpack(wire.pack(header, arrays))[0] == header
    return state, header


def picture_of(state: RendererState) -> np.ndarray:
    assert state.picture is not None
    return state.picture


def controlled(stage: RendererStage, state: RendererState, **control) -> RendererState:
    """The state after a control message."""
    return stage.on_message(state, (wire.ControlMessage(**control), ()))
