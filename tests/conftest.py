"""A small moving sequence and services as processes, for the tests of whole processes."""

import hashlib
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its threads spin against each other on a busy machine: ten times the time
import numpy as np
import pytest
import tomli_w
from hypothesis import settings as hypothesis_settings

from tests.support.browser import BROWSER_OPTIONS, CHROMIUM, SOFTWARE_GL
from tests.support.processes import ServiceProcesses, free_port
from vemlight.light.images import write_exr
from vemlight.settings import Settings
from vemlight.settings_file import read_settings

# How long an example takes says nothing on a busy machine; examples are the same in each run.
hypothesis_settings.register_profile("any machine", deadline=None, derandomize=True)
hypothesis_settings.load_profile("any machine")


@pytest.fixture(autouse=True)
def own_priority(monkeypatch):
    """A sender of packets raises its process's priority; the tests' own stays as it is."""
    monkeypatch.setattr(os, "setpriority", lambda *_: None)


@pytest.fixture(scope="session", autouse=True)
def simplified_once() -> Iterator[None]:
    """Measures the departure of each simplified mesh once a session: it takes most of the time to make a renderer."""
    from vemlight.renderer.passes.shadow_maps import simplification

    measure, measured = simplification._departure, {}

    def departure(old: np.ndarray, new: np.ndarray) -> float:
        key = hashlib.sha256(old.tobytes() + new.tobytes()).digest()
        if key not in measured:
            measured[key] = measure(old, new)
        return measured[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simplification, "_departure", departure)
        yield


@pytest.fixture(scope="session")
def sequence(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """16 lat-long frames, 32 x 64: a sky brighter above, and a sun that walks a column a frame."""
    folder = tmp_path_factory.mktemp("sequence")
    sky = np.linspace(1.0, 0.1, 32)[:, None, None] * np.array([0.5, 0.7, 1.0])
    for k in range(16):
        image = np.broadcast_to(sky, (32, 64, 3)).copy()
        image[9, 20 + k] += 400
        write_exr(folder / f"frame_{k:04d}.exr", image)
    return folder


@pytest.fixture
def make_settings(tmp_path: Path, sequence: Path) -> Callable[..., tuple[Settings, Path]]:
    """Writes a settings file; keywords replace whole sections' keys. Small pictures and few lights, so that tests are quick."""

    def make(name: str = "vemlight.toml", **sections) -> tuple[Settings, Path]:
        sockets = tmp_path / "sockets"
        sockets.mkdir(mode=0o700, exist_ok=True)
        content = {
            "wire": {"folder": str(sockets)},
            "capture": {"source": str(sequence)},
            "sampler": {"count": 16},
            "renderer": {"width": 64, "height": 48, "shadow_map": 64},
        }
        for key, value in sections.items():
            content[key] = {**content.get(key, {}), **value} if isinstance(value, dict) else value
        if content["wire"].get("transport") == "tcp":
            del content["wire"]["folder"]
        path = tmp_path / name
        path.write_text(tomli_w.dumps(content))
        return read_settings(path), path

    return make


@pytest.fixture
def services() -> Iterator[ServiceProcesses]:
    started = ServiceProcesses()
    yield started
    started.kill()


@pytest.fixture(scope="module")  # while it lives, no other test of this thread can run an event loop of its own
def browser() -> Iterator:
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, headless=True, args=BROWSER_OPTIONS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")  # as above
def software_gl_browser() -> Iterator:
    """A browser with WebGL."""
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, headless=True, args=BROWSER_OPTIONS + SOFTWARE_GL)
        yield browser
        browser.close()


@pytest.fixture
def run(services, make_settings):
    """Starts `vemlight run` on small settings; gives the settings and the process."""

    def start(*options: str, **sections) -> tuple[Settings, subprocess.Popen[bytes]]:
        settings, path = make_settings(viewer={"port": free_port()}, **sections)
        return settings, services.start("vemlight", "run", str(path), *options)

    return start


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--part", default="1/1", help="K/N: of N parts of the test files the K-th, so that N runs beside each other are all")
    parser.addoption("--long", action="store_true", help="also what is marked `long`: more windows, kills, rigs of what is tested anyway")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keeps one part of the files; skips what takes long unless it is asked for."""
    if not config.getoption("--long"):
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(pytest.mark.skip(reason="takes long: --long"))
    part, parts = map(int, str(config.getoption("--part")).split("/"))
    numbers = {path: k for k, path in enumerate(sorted({item.path for item in items}))}
    left_out = [item for item in items if numbers[item.path] % parts != part - 1]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if numbers[item.path] % parts == part - 1]
