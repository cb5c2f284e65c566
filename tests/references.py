"""Recorded messages of the bundled sequences: `make golden` rewrites them, test_replay.py compares.

Made by the stages' own steps in this process, so that the replay of whole processes is held against the pure functions.
"""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from vemlight.capture.stage import CaptureSource
from vemlight.renderer.stage import RendererStage
from vemlight.runtime import wire
from vemlight.runtime.loop import Stage
from vemlight.sampler.stage import SamplerStage
from vemlight.settings import Capture, Renderer, Sampler, Settings

ROOT = Path(__file__).parents[1]
FOLDER = Path(__file__).parent / "references"
SEQUENCES = ("outdoor", "interior")
FRAMES = 6
KINDS = ("map", "lights", "image")
CLOCKS = ("captured_ns", "monotonic_ns", "boot_id", "render_ms")  # what a replay cannot repeat, by name


def settings(sequence: str, **changes) -> Settings:
    """Small maps, few lights, small pictures; the 2005 method by name, so that a new default changes no reference."""
    return Settings(
        mode="lossless",
        capture=Capture(source=str(ROOT / "replay_data" / sequence), rows=18, cols=72, frames=FRAMES),
        sampler=Sampler(method="havran-azimuth", count=24, filter="fir2005"),
        renderer=Renderer(width=80, height=60, shadow_map=64),
        **changes,
    )


def recorded(sequence: str, kind: str) -> list[wire.Message]:
    """The reference messages."""
    parts = msgspec.msgpack.decode((FOLDER / f"{sequence}_{kind}.msgpack").read_bytes(), type=list[list[bytes]])
    return [wire.unpack(message) for message in parts]


def made(sequence: str) -> dict[str, list[wire.Message]]:
    """The messages that the steps make now."""
    wanted = settings(sequence)
    source = CaptureSource(wanted)
    maps = [source.message(k, k, k / source.fps) for k in range(FRAMES)]
    lights = _stepped(SamplerStage(wanted), maps)
    return {"map": maps, "lights": lights, "image": _stepped(RendererStage(wanted), lights, maps)}


def _stepped(stage: Stage, messages: list[wire.Message], side: Sequence[wire.Message] = ()) -> list[wire.Message]:
    """A stage's results; side: what it is given before each step."""
    state, _ = stage.start_at(0)
    out = []
    for k, message in enumerate(messages):
        for own in side[k : k + 1]:
            state = stage.on_message(state, own)
        state, result = stage.step(state, message)
        out.append(result)
    return out


def without_clocks(header: wire.Header) -> dict:
    """The header's fields, those in CLOCKS left out."""

    def timeless(value):
        return {key: timeless(v) for key, v in value.items() if key not in CLOCKS} if isinstance(value, dict) else value

    return timeless(msgspec.to_builtins(header))


def _still(message: wire.Message) -> list[bytes]:
    """The message's parts with its clocks at zero, so that a reference changes only where the content does."""
    header, arrays = message
    content = msgspec.to_builtins(header)
    content["stamp"] |= {"captured_ns": 0, "monotonic_ns": 0, "boot_id": ""}
    if isinstance(header, wire.ImageMessage):
        content["report"]["render_ms"] = 0.0
    return wire.pack(msgspec.convert(content, type(header)), [np.asarray(a) for a in arrays])


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in SEQUENCES:
        for kind, messages in made(name).items():
            (FOLDER / f"{name}_{kind}.msgpack").write_bytes(msgspec.msgpack.encode([_still(message) for message in messages]))
