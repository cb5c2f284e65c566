"""The page in a real browser: objects and lamps are selected, moved, turned and scaled by handles over the picture, and by keys."""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.browser import CHROMIUM, WINDOWS, new_page, with_summary
from tests.support.hands import drag, newest
from tests.support.viewer_process import SimulatedServices, ViewerProcess, eventually
from vemlight.settings import Wire

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")
STAND_IN = """
export * from "/scene_data.js?real";
export async function loadScene() {
  return { cameras: [{ from: [0, -8, 0.5], at: [0, 0, 0.5], fov_y: 40 }] };
}
export function pick(scene, poses, { from, to }) { // the box, as a ball of radius 0.5
  const { name, position } = poses.find((pose) => pose.name === "box"), off = position.map((value, k) => value - from[k]);
  const length = Math.hypot(...to), along = off.reduce((sum, value, k) => sum + (value * to[k]) / length, 0);
  return Math.hypot(...off) ** 2 - along ** 2 < 0.25 ? { name } : null;
}
"""
NEAR = [  # in the picture, beside it, behind the eye
    {"id": 7, "at": [-1.0, 0.0, 1.5], "distance_m": 1.25, "sigma_m": 0.01},
    {"id": 8, "at": [50.0, 0.0, 0.5], "distance_m": 50.0, "sigma_m": 1.0},
    {"id": 9, "at": [0.0, -9.0, 0.5], "distance_m": 9.0, "sigma_m": 0.1},
]
PIXELS_A_METRE = 0.5 / (8 * math.tan(math.radians(20)))  # of the picture's height, in the plane of the objects


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("gizmo")
    folder.chmod(0o700)
    return folder


@pytest.fixture(scope="module")
def simulated(folder: Path) -> Iterator[SimulatedServices]:
    simulated = SimulatedServices(Wire(folder=str(folder)))
    simulated.start()
    yield simulated
    simulated.end()


@pytest.fixture(scope="module", params=WINDOWS)
def opened(folder: Path, simulated: SimulatedServices, browser, request) -> Iterator:
    viewer = ViewerProcess(folder)
    viewer.first_line()
    page = new_page(browser, request.param)
    page.viewer, page.summary = viewer, {"scene": {"hash": "1", "text": ""}, "near_lights": NEAR}
    page.route("**/scene_data.js", lambda route: route.fulfill(body=STAND_IN, content_type="text/javascript"))
    page.route_web_socket("**/ws*", lambda route: with_summary(route, page.summary))
    yield page
    assert page.complaints == []
    page.context.close()
    viewer.end()


@pytest.fixture
def picture(opened, simulated):
    """The page with a scene: the box stands at (1, 0, 0.5), the eye looks along +y."""
    opened.goto("about:blank")  # which sends nothing any more
    opened.viewer.choose(poses=[])
    opened.goto(opened.viewer.url)
    opened.locator("[data-gizmo=move]:enabled").wait_for()
    eventually(lambda: simulated.controls and newest(simulated).poses == (), "nothing chosen")
    opened.locator("#gizmo").scroll_into_view_if_needed()
    return opened


def in_picture(page, x_m: float, z_m: float) -> tuple[float, float]:
    """Where a point of the plane y = 0 is, in CSS pixels of the window."""
    box = page.locator("#gizmo").bounding_box()
    height = min(box["height"], box["width"] * 48 / 64)
    unit = PIXELS_A_METRE * height
    return box["x"] + box["width"] / 2 + x_m * unit, box["y"] + box["height"] / 2 - (z_m - 0.5) * unit


def test_a_click_selects_and_handles_move_turn_and_scale(picture, simulated):
    page = picture
    assert page.locator("#object").input_value() == "lamp"
    page.mouse.click(*in_picture(page, 1.0, 0.7))
    eventually(lambda: page.locator("#object").input_value() == "box", "the box selected")
    page.mouse.click(*in_picture(page, 0.0, 2.0))
    eventually(lambda: page.locator("#object").input_value() == "lamp", "the lamp selected")
    page.mouse.click(*in_picture(page, 1.0, 0.7))

    page.locator("[data-gizmo=move]").click()
    drag(page, in_picture(page, 1.5, 0.5), in_picture(page, 2.25, 0.5))
    eventually(lambda: newest(simulated).poses, "the box moved")
    eventually(lambda: newest(simulated).poses[0].position[0] == pytest.approx(1.75, abs=0.03), "to where it was dragged")
    assert newest(simulated).poses[0].position[1:] == (0.0, 0.5)
    page.keyboard.down("Control")
    drag(page, in_picture(page, 1.75, 0.9), in_picture(page, 1.75, 1.17))
    page.keyboard.up("Control")
    eventually(lambda: newest(simulated).poses[0].position[2] == pytest.approx(0.8, abs=1e-6), "up, in steps")
    assert page.locator("#object-z").input_value() == "0.8"

    page.locator("[data-gizmo=scale]").click()
    page.locator("#gizmo").press("ArrowUp")
    eventually(lambda: newest(simulated).poses[0].scale == pytest.approx(1.1), "larger, by a key")
    page.locator("#object-scale").fill("2")
    eventually(lambda: newest(simulated).poses[0].scale == 2.0, "larger, by its number")
    page.locator("#gizmo").press("e")
    page.locator("#gizmo").press("ArrowRight")
    page.locator("#gizmo").press("PageUp")
    eventually(lambda: abs(newest(simulated).poses[0].rotation[2]) > 0.1, "turned by keys")
    names = []
    while not page.locator("#undo").is_disabled():
        names.append(page.locator("#undo").get_attribute("aria-label"))
        page.locator("#undo").click()
    assert set(names) == {"Undo: moved box", "Undo: scaled box", "Undo: turned box"}
    eventually(lambda: newest(simulated).poses == (), "all back")


def test_near_lights_are_marked_where_they_are_in_the_picture(picture):
    eventually(lambda: picture.locator("#gizmo").get_attribute("data-near") == "7", "the one that is in the picture")
    (x, y), box = in_picture(picture, -1.0, 1.5), picture.locator("#gizmo").bounding_box()
    inked = """(canvas, [x, y]) => {
        const side = 24 * devicePixelRatio, copy = new OffscreenCanvas(side, side).getContext("2d", { willReadFrequently: true });
        copy.drawImage(canvas, side / 2 - x * devicePixelRatio, side / 2 - y * devicePixelRatio);
        return copy.getImageData(0, 0, side, side).data.some((value, k) => k % 4 === 3 && value > 200);
    }"""
    assert picture.locator("#gizmo").evaluate(inked, [x - box["x"], y - box["y"]])
    assert not picture.locator("#gizmo").evaluate(inked, [x - box["x"] - 60, y - box["y"]])


def test_a_finger_moves_an_object_and_does_not_scroll(picture, simulated):
    page = picture
    page.mouse.click(*in_picture(page, 1.0, 0.7))
    page.locator("[data-gizmo=move]").click()
    session, scrolled = page.context.new_cdp_session(page), page.evaluate("scrollY")
    (x, y), (to_x, to_y) = in_picture(page, 1.0, 0.9), in_picture(page, 1.0, 1.4)  # the axis that is up, as scrolling goes
    for kind, part in [("touchStart", 0), *[("touchMove", k / 8) for k in range(1, 9)], ("touchEnd", None)]:
        points = [] if part is None else [{"x": x + part * (to_x - x), "y": y + part * (to_y - y)}]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    eventually(lambda: newest(simulated).poses, "the box moved")
    eventually(lambda: newest(simulated).poses[0].position[2] == pytest.approx(1.0, abs=0.04), "up")
    assert page.evaluate("scrollY") == scrolled


def test_a_ring_turns_by_the_angle_of_the_drag(picture, simulated):
    page = picture
    page.mouse.click(*in_picture(page, 1.0, 0.7))
    page.locator("[data-gizmo=turn]").click()
    height = 0.2 * 8 * 2 * math.tan(math.radians(20)) * 0.85  # of the ring's radius, metres
    drag(page, in_picture(page, 1.0 + height * 0.6, 0.5 + height * 0.8), in_picture(page, 1.0 + height * 0.96, 0.5 + height * 0.28))
    eventually(lambda: newest(simulated).poses, "the box turned")
    wanted = math.acos(0.6 * 0.96 + 0.8 * 0.28)
    eventually(lambda: 2 * math.asin(newest(simulated).poses[0].rotation[1]) == pytest.approx(wanted, abs=0.03), "clockwise about +y")
    assert newest(simulated).poses[0].rotation[0] == pytest.approx(0, abs=1e-6)


def test_an_object_is_moved_while_the_renderer_is_dead(picture, simulated):
    page = picture
    simulated.publishing.discard("renderer")
    page.locator("#overall[data-state=silent], #overall[data-state=stalled]").wait_for()
    page.locator("[data-gizmo=move]").click()
    page.locator("#gizmo").press("ArrowRight")
    eventually(lambda: newest(simulated).poses, "moved")
    page.locator("#undo").click()
    eventually(lambda: newest(simulated).poses == (), "and back")
    assert "renderer" in page.locator("#overall").inner_text()
    simulated.publishing.add("renderer")
    page.locator("#overall[data-state=live]").wait_for()


def test_without_a_scene_there_are_no_handles_and_a_line_says_why(picture):
    page = picture
    page.summary["scene"] = {"hash": "", "text": "the scene is too large"}
    page.reload()
    page.locator("[data-gizmo=move][title*='too large']").wait_for()
    assert page.locator("[data-gizmo=move]").is_disabled()
