"""The page's own feed of lights: near ones stand in it where they are, and its decoder gives every number as it was sent."""

import base64

import numpy as np
import pytest

from tests.support.browser import CHROMIUM
from tests.support.light_sets import some_lights
from vemlight.light.as_directional import as_directional
from vemlight.light.light_set import NearLights
from vemlight.light.lights_binary import placed_binary
from vemlight.light.near_lights import NearLightSet
from vemlight.viewer.web import PAGE, constants_js

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")
ADDRESS = "http://lights.test/"
DECODE = """async (data) => {
    const { lightsFromBytes } = await import("/lights_from_bytes.js");
    try {
        return lightsFromBytes(Uint8Array.from(atob(data), (c) => c.charCodeAt(0)).buffer);
    } catch (error) {
        return String(error);
    }
}"""


@pytest.fixture(scope="module")
def page(browser):
    page = browser.new_page()

    def answer(route) -> None:
        name = route.request.url.removeprefix(ADDRESS)
        if not name:
            return route.fulfill(content_type="text/html", body="<!doctype html>")
        script = constants_js() if name == "constants.js" else (PAGE / name).read_text()
        return route.fulfill(content_type="text/javascript", body=script)

    page.route(f"{ADDRESS}**", answer)
    page.goto(ADDRESS)
    yield page
    page.close()


def decoded(page, data: bytes):
    return page.evaluate(DECODE, base64.b64encode(data).decode())


def some_near(count: int) -> NearLights:
    random = np.random.default_rng(count + 1)
    at, intensity, radius = random.normal(size=(count, 3)), random.random((count, 3)), random.random(count) / 5
    return NearLights(NearLightSet.of(np.arange(count) + 2**31, at, intensity, radius, np.zeros(count)), (0.5, -1.0, 1.2))


@pytest.mark.parametrize(("count", "soft", "near_count"), [(0, False, 0), (0, True, 1), (1, False, 0), (16, True, 8), (73, False, 3)])
def test_every_number_arrives_and_near_lights_are_seen_from_the_map_s_place(page, count, soft, near_count):
    lights, near = some_lights(count, soft), some_near(near_count)
    frame = decoded(page, placed_binary(lights, near, 2**40 + 1, 12.5, "sphere"))
    assert (frame["sequence"], frame["time_s"], frame["coverage"]) == (2**40 + 1, 12.5, "sphere")
    for k, light in enumerate(frame["directional"]):
        assert light["id"] == lights.ids[k]
        assert light["direction"] == lights.directions[k].tolist()
        assert light["irradiance"] == lights.irradiance[k].tolist()
        assert light.get("covariance") == (lights.covariances[k].tolist() if lights.covariances is not None else None)
    rows = [(row["id"], row["at"], row["intensity"], row["radius"]) for row in frame["near"]]
    points = near.points
    assert rows == list(zip(points.ids.tolist(), points.at.tolist(), points.intensity.tolist(), points.radius.tolist(), strict=True))
    whole = as_directional(lights, near)
    assert [light["id"] for light in frame["lights"]] == whole.ids.tolist()
    if len(whole.ids):
        np.testing.assert_allclose([light["direction"] for light in frame["lights"]], whole.directions, atol=1e-6)
        np.testing.assert_allclose([light["irradiance"] for light in frame["lights"]], whole.irradiance, rtol=1e-6)


def test_72_lights_of_any_kind_fit_6_kb():
    sizes = [len(placed_binary(some_lights(n, True), some_near(72 - n), 1, 0.0, "sphere")) for n in (72, 36, 0)]
    assert sizes == [56 + 72 * 56, 56 + 36 * 56 + 36 * 36, 56 + 72 * 36]
    assert max(sizes) < 6000


def test_the_decoder_refuses_what_is_something_else(page):
    data = placed_binary(some_lights(3, True), some_near(2), 1, 0.0, "hemisphere")
    longer = [data[:at] + b"\xff" + data[at + 1 :] for at in (4, 48)]  # more lights than there are, of either kind
    for damaged in (b"", data[:55], data[:-1], data + b"\0", data[:1] + b"\2" + data[2:], data[:2] + b"\5" + data[3:], *longer):
        assert decoded(page, damaged).startswith("Error: lights ")
