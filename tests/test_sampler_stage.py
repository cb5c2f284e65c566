"""The sampler as a stage."""

import subprocess
import sys
from typing import Literal

import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.runtime import stamps, wire
from vemlight.sampler.stage import SamplerStage
from vemlight.settings import Sampler, Settings

FIRST_MAP = """
import sys
import numpy as np
from vemlight.runtime import stamps, wire
from vemlight.sampler.stage import SamplerStage
from vemlight.settings import Sampler, Settings

def compiled():
    modules = [module for name, module in sys.modules.items() if name.startswith("vemlight.")]
    return {f"{name}{loop.signatures}" for module in modules for name, loop in vars(module).items() if hasattr(loop, "signatures")}

stage = SamplerStage(Settings(sampler=Sampler(method=sys.argv[1])))
ready = compiled()
state, _ = stage.start_at(0)
for k in range(30):  # light that flickers with the mains, until the search for it has begun
    header = wire.MapMessage(stamp=stamps.stamp(k, k / 21), rows=6, cols=24, coverage="hemisphere", bright_samples=1)
    radiance = np.full((6, 24, 3), 1 + 0.3 * np.sin(200 * np.pi * k / 21), np.float32)
    arrays = radiance, np.array([30]), np.array([[0.0, 0.0, 1.0]], np.float32), np.ones(1, np.float32)
    state, _ = stage.step(state, wire.unpack(wire.pack(header, arrays)))
assert ready and compiled() == ready, compiled() - ready
"""


@pytest.mark.parametrize("method", ["tracked", "standard", "havran-azimuth"])
def test_first_map_waits_for_no_compiler(method: str) -> None:
    """In a process of its own, because every other test compiles too."""
    done = subprocess.run([sys.executable, "-c", FIRST_MAP, method], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("name", "frames"), [("fir2005", 4), ("binomial", 2), ("none", 0)])
def test_the_filters_delay_goes_out_in_frames_and_in_ms(name, frames) -> None:
    stage = SamplerStage(Settings(sampler=Sampler(method="havran-azimuth", filter=name, count=4)))
    state, _ = stage.start_at(0)
    for k in range(6):
        header = wire.MapMessage(stamp=stamps.stamp(k, k / 25), rows=6, cols=24, coverage="hemisphere")
        arrays = np.ones((6, 24, 3), np.float32), *NO_BRIGHT_CELLS
        state, (made, _) = stage.step(state, (header, arrays))
    assert isinstance(made, wire.LightsMessage)
    assert (made.report.delay_frames, made.report.delay_ms) == pytest.approx((frames, frames * 40))


@pytest.mark.parametrize("method", ["tracked", "havran-azimuth"])
def test_after_a_jump_lights_are_those_of_a_sampler_that_begins_and_no_old_one_comes_back(
    method: Literal["tracked", "havran-azimuth"],
) -> None:
    """The filters have nothing of before, although time goes on by one frame, and the tracked lights' ids are new."""
    rng = np.random.default_rng(3)
    before, after = (rng.exponential(1.0, (8, 32, 3)).astype(np.float32) ** 2 for _ in range(2))
    stage = SamplerStage(Settings(sampler=Sampler(method=method, count=12)))

    def stepped(state, k: int, radiance: np.ndarray, segment: int):
        header = wire.MapMessage(stamp=stamps.stamp(k, k / 25), rows=8, cols=32, coverage="hemisphere", segment=segment)
        return stage.step(state, (header, (radiance, *NO_BRIGHT_CELLS)))

    state, _ = stage.start_at(0)
    for k in range(5):
        state, (_, old) = stepped(state, k, before, 0)
    _, (_, fresh) = stepped(stage.start_at(0)[0], 5, after, 1)
    _, (_, steady) = stepped(state, 5, after, 0)
    state, (_, jumped) = stepped(state, 5, after, 1)
    assert not all(np.array_equal(a, b) for a, b in zip(steady[1:3], fresh[1:3], strict=True))
    for a, b in zip(jumped[1:], fresh[1:], strict=True):
        assert np.array_equal(a, b)
    if method == "tracked":
        assert not set(jumped[0].tolist()) & set(old[0].tolist())
    _, (_, again) = stepped(state, 6, after, 1)  # the segment goes on: the lights stay
    assert set(again[0].tolist()) <= set(range(int(jumped[0].max()) + 12))
    assert len(set(again[0].tolist()) & set(jumped[0].tolist())) > 8
