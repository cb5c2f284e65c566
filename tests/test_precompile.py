"""That `make env` leaves nothing to compile: the default paths ask numba for no kernel that precompile did not ask for."""

import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from vemlight.light.images import write_exr, write_png
from vemlight.renderer.rays.embree import library

ROOT = Path(__file__).parents[1]
BUNDLED = ROOT / "replay_data" / "outdoor"
COMMAND = "from vemlight.commands.cli import main\nimport sys\nmain(sys.argv[1:], standalone_mode=False)"
RUN = """
from vemlight.capture.stage import CaptureSource
from vemlight.renderer.stage import RendererStage
from vemlight.sampler.stage import SamplerStage
from vemlight.settings import Settings

settings = Settings()
sampler, renderer = SamplerStage(settings), RendererStage(settings)
source = CaptureSource(settings)
lights_state, image_state = sampler.start_at(0)[0], renderer.start_at(0)[0]
for k in range(2):
    frame = source.message(k, k, k / 25)
    for array in frame[1]:
        array.flags.writeable = False
    lights_state, lights = sampler.step(lights_state, frame)
    image_state, _ = renderer.step(renderer.on_message(image_state, frame), lights)
"""


def asked(statements: str, *arguments: object) -> set[str]:
    """The kernels, each with the types of its arguments, that a process asks for."""
    command = [sys.executable, "-m", "tests.support.kernels_asked", statements, *map(str, arguments)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(json.loads(run.stdout.splitlines()[-1]))


@cache
def precompiled() -> set[str]:
    return asked("from vemlight.commands import precompile\nfor job in precompile.JOBS:\n    job()")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """With an EXR, an HDR, a PNG and two frames of a fisheye."""
    made = tmp_path_factory.mktemp("sources")
    radiance = np.random.default_rng(0).random((32, 64, 3)).astype(np.float32)
    write_exr(made / "map.exr", radiance)
    codes = (255 * radiance).astype(np.uint8)
    write_png(made / "map.png", np.dstack([codes, np.full(codes.shape[:2], 255, np.uint8)]))
    rgbe = np.dstack([codes, np.full(codes.shape[:2], 128, np.uint8)])
    (made / "map.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 64\n" + rgbe.tobytes())
    return made


@pytest.mark.parametrize(
    "arguments",
    [
        ("lights", "map.exr", "--out", "lights.json"),
        ("lights", "map.hdr", "--points", "--out", "lights.json"),
        ("lights", "map.png", "--transfer", "srgb", "--out", "lights.json"),
        ("lights", str(BUNDLED), "--frames", "3", "--out", "lights.jsonl"),
        ("render", "map.exr", "--size", "64x48", "--out", "picture.png"),
        ("polar", "map.hdr", "--out", "polar.exr"),
    ],
)
def test_commands_compile_nothing_after_precompile(folder, monkeypatch, arguments):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.chdir(folder)
    missing = asked(COMMAND, *arguments) - precompiled()
    assert not missing


@pytest.mark.skipif(library() is None, reason="Embree is not installed")
def test_precompile_has_the_kernels_of_rays_and_bounce():
    names = {name.partition(" ")[0].rpartition(".")[2] for name in precompiled()}
    assert {"_trace", "filter_rows", "find_hits", "light_hits", "follow_mirrored", "filter_lobes"} <= names


def test_a_run_compiles_nothing_after_precompile():
    assert not asked(RUN) - precompiled()
