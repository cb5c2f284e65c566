"""The JavaScript of clients/ in a real browser, from another origin: the decoder, the shape of WebXR's light estimation, the examples."""

import base64
import functools
import http.server
import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.support.browser import CHROMIUM
from tests.support.light_sets import some_lights
from tests.support.viewer_process import PATIENCE_S, SimulatedServices, ViewerProcess, eventually, frames_of
from vemlight.light.light_set import LightSet
from vemlight.light.lights_binary import binary_from_lights
from vemlight.settings import Wire

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the clients' JavaScript is not tested")
CLIENTS = Path(__file__).parents[1] / "clients"
PACKAGES = ("three@0.187.0", "babylonjs@9.35.0")
INSTALL_S = 240


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """A copy of clients/, to which a test may add packages."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(CLIENTS, folder, dirs_exist_ok=True)
    (folder / "blank.html").write_text("<!doctype html><title>blank</title>")
    return folder


@pytest.fixture(scope="module")
def origin(site: Path) -> Iterator[str]:
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(site)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()


@pytest.fixture(scope="module")
def viewer(tmp_path_factory, origin: str) -> Iterator[ViewerProcess]:
    """Of few lights, so that Babylon's pool holds them."""
    folder = tmp_path_factory.mktemp("viewer")
    folder.chmod(0o700)
    simulated = SimulatedServices(Wire(folder=str(folder)), lambda sequence, _: frames_of(sequence, 9))
    simulated.start()
    viewer = ViewerProcess(folder, more=f'origins = ["{origin}"]')
    viewer.first_line()
    eventually(lambda: viewer.get("/healthz")[0] == 200, "all services seen")
    yield viewer
    viewer.end()
    simulated.end()


@pytest.fixture(scope="module")
def page(browser, origin: str):
    page = browser.new_page()
    page.set_default_timeout(PATIENCE_S * 1e3)
    page.goto(f"{origin}/blank.html")
    return page


DECODE = """async ([data, call]) => {
    const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
    const { decodeLights } = await import("/lights.js");
    const { estimateFrom } = await import("/light_estimation.js");
    const plain = (key, value) => (ArrayBuffer.isView(value) ? [...value] : value);
    try {
        const frame = decodeLights(bytes.buffer);
        return JSON.stringify(call === "decode" ? frame : estimateFrom(frame), plain);
    } catch (error) {
        return JSON.stringify(String(error));
    }
}"""


def in_browser(page, data: bytes, call: str = "decode"):
    return json.loads(page.evaluate(DECODE, [base64.b64encode(data).decode(), call]))


@pytest.mark.parametrize(("count", "soft"), [(0, False), (0, True), (1, False), (72, True), (73, False)])
def test_the_decoder_gives_every_number_as_it_was_sent(page, count, soft):
    lights = some_lights(count, soft)
    frame = in_browser(page, binary_from_lights(lights, 2**40 + 1, 12.5, "sphere"))
    assert (frame["sequence"], frame["timeS"], frame["coverage"], frame["count"]) == (2**40 + 1, 12.5, "sphere", count)
    assert frame["ids"] == lights.ids.tolist()
    assert frame["directions"] == lights.directions.ravel().tolist()
    assert frame["irradiance"] == lights.irradiance.ravel().tolist()
    assert frame["covariances"] == (lights.covariances.ravel().tolist() if lights.covariances is not None else None)


def test_the_decoder_refuses_what_is_something_else(page):
    data = binary_from_lights(some_lights(3, True), 1, 0.0, "hemisphere")
    for damaged in (b"", data[:23], data[:-1], data + b"\0", b"\2" + data[1:], data[:1] + b"\2" + data[2:], data[:4] + b"\xff" + data[5:]):
        assert in_browser(page, damaged).startswith("Error: ")


def test_the_estimate_s_harmonics_give_the_irradiance_of_the_lights(page):
    """Ramamoorthi and Hanrahan 2001: irradiance is the sum of A_l L_lm Y_lm(n), A = pi, 2 pi / 3, pi / 4, within 3 % of all frequencies.

    Y by their formulas in angles, not in the coordinates of the code.
    """
    random = np.random.default_rng(5)
    directions = random.normal((0, 0, 0.7), size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lights = LightSet.of(np.arange(400), directions, random.random((400, 3)) + 0.2)
    found = in_browser(page, binary_from_lights(lights, 1, 0.0, "sphere"), "estimate")
    coefficients = np.array(found["sphericalHarmonicsCoefficients"]).reshape(9, 3)
    normals = random.normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    theta, phi = np.arccos(normals[:, 2]), np.arctan2(normals[:, 1], normals[:, 0])
    harmonics = np.sqrt(1 / (4 * np.pi)) * np.stack([
        np.ones_like(theta),
        np.sqrt(3) * np.sin(theta) * np.sin(phi), np.sqrt(3) * np.cos(theta), np.sqrt(3) * np.sin(theta) * np.cos(phi),
        np.sqrt(15) / 2 * np.sin(theta) ** 2 * np.sin(2 * phi), np.sqrt(15) / 2 * np.sin(2 * theta) * np.sin(phi),
        np.sqrt(5) / 4 * (3 * np.cos(2 * theta) + 1),
        np.sqrt(15) / 2 * np.sin(2 * theta) * np.cos(phi), np.sqrt(15) / 2 * np.sin(theta) ** 2 * np.cos(2 * phi),
    ])  # fmt: skip
    bands = np.array([np.pi, *3 * [2 * np.pi / 3], *5 * [np.pi / 4]])
    in_page = lights.directions[:, [0, 2, 1]] * [1, 1, -1]
    irradiance = np.maximum(normals @ in_page.T, 0) @ lights.irradiance
    by_harmonics = np.einsum("in,i,ic->nc", harmonics, bands, coefficients)
    assert np.abs(by_harmonics - irradiance).max() < 0.04 * irradiance.max()


def test_the_estimate_s_primary_light_is_the_strongest(page):
    lights = some_lights(50, False)
    irradiance = lights.irradiance.copy()
    irradiance[17] = 9, 8, 7
    found = in_browser(page, binary_from_lights(lights._replace(irradiance=irradiance), 1, 0.0, "sphere"), "estimate")
    x, y, z = lights.directions[17].tolist()
    assert found["primaryLightDirection"] == {"x": x, "y": z, "z": -y, "w": 0}
    assert found["primaryLightIntensity"] == {"x": 9, "y": 8, "z": 7, "w": 1}
    dark = in_browser(page, binary_from_lights(LightSet.none(), 1, 0.0, "sphere"), "estimate")
    assert dark["primaryLightIntensity"] == {"x": 0, "y": 0, "z": 0, "w": 1}


def test_a_page_elsewhere_watches_the_lights_live(page, viewer):
    seen = page.evaluate(
        """(address) => new Promise(async (done) => {
            const { watchLights } = await import("/lights.js");
            const frames = [];
            const end = watchLights(address, (frame) => {
                frames.push([frame.sequence, [...frame.ids], [...frame.directions]]);
                if (frames.length === 5) { end(); done(frames); }
            });
        })""",
        viewer.url.replace("http", "ws"),
    )
    assert [sequence for sequence, *_ in seen] == sorted({sequence for sequence, *_ in seen})
    for sequence, ids, directions in seen:
        _, (expected_ids, expected, *_) = frames_of(sequence, 9)["sampler"]
        assert ids == expected_ids.tolist()
        assert np.abs(np.array(directions).reshape(9, 3) - expected).max() <= 1e-6


def test_a_probe_has_an_estimate_with_the_first_frame(page, viewer):
    found = page.evaluate(
        """async (address) => {
            const { LightProbe } = await import("/light_estimation.js");
            const probe = new LightProbe(address);
            const before = probe.estimate();
            await new Promise((done) => probe.addEventListener("reflectionchange", done, { once: true }));
            probe.end();
            return [before, probe.estimate().sphericalHarmonicsCoefficients.length];
        }""",
        viewer.url.replace("http", "ws"),
    )
    assert found == [None, 27]


@pytest.fixture(scope="module")
def packages(site: Path) -> None:
    npm = shutil.which("npm")
    if npm is None:
        pytest.skip("npm is not installed: the examples with three.js and Babylon.js are not tested")
    command = [npm, "install", "--no-audit", "--no-fund", "--no-save", "--no-package-lock", "--ignore-scripts", *PACKAGES]
    try:
        done = subprocess.run(command, cwd=site, capture_output=True, text=True, timeout=INSTALL_S)
    except subprocess.TimeoutExpired:
        pytest.skip(f"npm brought no packages within {INSTALL_S} s: the examples are not tested")
    if done.returncode:
        pytest.skip("npm brought no packages: the examples with three.js and Babylon.js are not tested")


# Of each light of the pool: irradiance, and the direction to the light in the page's space.
POOLS = {
    "three": """() => window.pool.map((light) => {
        const to = light.position.clone().normalize();
        return [light.intensity * light.color.r, light.intensity * light.color.g, light.intensity * light.color.b, to.x, to.y, to.z];
    })""",
    "babylon": """() => window.pool.map((light) => {
        const { r, g, b } = light.diffuse;
        const { x, y, z } = light.direction;
        return [light.intensity * r, light.intensity * g, light.intensity * b, -x, -y, -z];
    })""",
}


@pytest.mark.parametrize("library", POOLS)
def test_an_example_s_lights_are_the_frame_s(browser, packages, origin, viewer, library):
    page = browser.new_page(viewport={"width": 320, "height": 240})
    page.set_default_timeout(PATIENCE_S * 1e3)
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(f"{origin}/{library}.html?viewer={viewer.url.replace('http', 'ws')}")
    page.wait_for_function("() => window.pool && window.pool.filter((light) => light.intensity).length === 9")
    page.evaluate("() => window.end()")
    pool = np.array(page.evaluate(POOLS[library]))
    assert complaints == []
    assert (pool[9:, :3] == 0).all()
    _, (_, directions, irradiance, *_) = frames_of(0, 9)["sampler"]
    assert np.allclose(pool[:9, :3], irradiance, rtol=1e-6)
    assert np.allclose(pool[:9, 4], directions[:, 2], atol=1e-6)  # their height; they go round
    turned = np.arctan2(-pool[:9, 5], pool[:9, 3]) - np.arctan2(directions[:, 1], directions[:, 0])
    assert np.abs(np.exp(1j * turned) - np.exp(1j * turned[0])).max() < 1e-5  # all by the same angle
    page.close()
