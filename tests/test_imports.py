"""What a start may load: a heavy library that slips into one costs each restart and each command its time."""

import json
import subprocess
import sys

import pytest

HEAVY = {"scipy.stats", "scipy.signal", "scipy.optimize", "trimesh", "av", "matplotlib", "prometheus_client", "rich.progress"}
# Beside HEAVY, what a service's start must not load.
FORBIDDEN = {
    "capture": {"scipy.linalg", "cv2", "moderngl", "aiohttp", "PIL", "OpenEXR"},
    "sampler": {"scipy.linalg", "cv2", "moderngl", "aiohttp", "PIL", "OpenEXR"},
    "renderer": {"numba", "scipy", "cv2", "aiohttp", "OpenEXR"},
    "viewer": {"numba", "scipy", "moderngl", "PIL", "OpenEXR"},
    "fixtures": {"scipy.linalg", "cv2", "moderngl", "aiohttp", "PIL", "OpenEXR", "av"},
    "plate": {"numba", "scipy", "moderngl", "aiohttp", "PIL"},
}
LOADED = "import sys, json; print(json.dumps(sorted(sys.modules)), file=sys.stderr)"


def loaded_by(statements: str, *arguments: str) -> set[str]:
    """The modules in a process after these statements."""
    run = subprocess.run([sys.executable, "-c", f"{statements}\n{LOADED}", *arguments], capture_output=True, text=True, check=True)
    return set(json.loads(run.stderr.splitlines()[-1]))


@pytest.mark.parametrize("service", FORBIDDEN)
def test_a_service_starts_without_what_it_may_never_need(service):
    modules = loaded_by(f"import vemlight.{service}.__main__")
    assert f"vemlight.{service}.__main__" in modules
    assert not modules & (HEAVY | FORBIDDEN[service])


def test_the_lights_of_a_map_take_numpy_and_numba(tmp_path):
    statements = """
import sys
import numpy as np
from pathlib import Path
from vemlight.light.images import write_exr
from vemlight.commands.cli import main
write_exr(Path(sys.argv[1]), np.ones((8, 16, 3), np.float32))
main(["lights", sys.argv[1], "--count", "4", "--out", sys.argv[2]], standalone_mode=False)
"""
    modules = loaded_by(statements, str(tmp_path / "map.exr"), str(tmp_path / "lights.json"))
    assert "numba" in modules
    assert not modules & (HEAVY | {"scipy.linalg", "scipy.special", "cv2", "moderngl", "aiohttp", "zmq.auth"})


def test_the_bundled_scene_is_read_without_trimesh_and_scipy():
    statements = "from vemlight.renderer.scene.scene import load_scene\nload_scene(None)"
    assert not loaded_by(statements) & {"trimesh", "scipy", "numba", "cv2"}
