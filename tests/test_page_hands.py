"""The page in a real browser: masks and virtual lamps drawn on the sky, undo and redo, what is saved; by pointer and by keys."""

import cmath
import math
import struct
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.browser import CHROMIUM, WINDOWS, new_page
from tests.support.hands import drag, newest
from tests.support.viewer_process import SimulatedServices, ViewerProcess, eventually
from vemlight.light.mask import Mask
from vemlight.light.virtual_lamp import VIRTUAL_IDS_FROM, VirtualLamp
from vemlight.runtime import wire
from vemlight.settings import Settings, Wire
from vemlight.toml import record_from_toml

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")
RIM = 19  # CSS pixels around the disc (sky.js)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("hands")
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
    page.viewer = viewer
    page.goto(viewer.url)
    page.locator("#overall[data-state=live]").wait_for()
    yield page
    assert page.complaints == []
    page.context.close()
    viewer.end()


@pytest.fixture
def page(opened, simulated):
    """The page with nothing chosen."""
    chosen = ("count", "exposure", "filtered", "masks", "lamps")
    opened.goto("about:blank")  # which sends nothing any more
    opened.viewer.choose(**dict.fromkeys(chosen), poses=[])
    opened.goto(opened.viewer.url)
    opened.locator("#overall[data-state=live]").wait_for()
    eventually(lambda: simulated.controls and simulated.controls[-1] == wire.ControlMessage(), "nothing chosen")
    return opened


def place(page, azimuth_deg: float, elevation_deg: float) -> tuple[float, float]:
    """Where a direction is on the disc, in CSS pixels of the window."""
    page.locator("#disc").scroll_into_view_if_needed()
    box = page.locator("#disc").bounding_box()
    r, phi = (90 - elevation_deg) / 90 * (box["width"] / 2 - RIM), math.radians(azimuth_deg)
    return box["x"] + box["width"] / 2 - r * math.cos(phi), box["y"] + box["height"] / 2 - r * math.sin(phi)


def on_disc(azimuth_deg: float, elevation_deg: float) -> complex:
    """A direction on the disc, in degrees from its middle."""
    return (90 - elevation_deg) * cmath.exp(1j * math.radians(azimuth_deg))


def masks(simulated: SimulatedServices) -> tuple[Mask, ...]:
    return newest(simulated).masks or ()


def lamps(simulated: SimulatedServices) -> tuple[VirtualLamp, ...]:
    return newest(simulated).lamps or ()


def tool(page, name: str) -> None:
    page.locator("#sky-tools").get_by_role("button", name=name).click()


def test_a_polygon_is_drawn_moved_and_undone(page, simulated):
    tool(page, "Polygon")
    corners = [(100.0, 20.0), (140.0, 20.0), (120.0, 55.0)]
    for corner in [*corners, corners[0]]:
        page.mouse.click(*place(page, *corner))
    (mask,) = eventually(lambda: newest(simulated).masks, "the mask")
    assert (mask.mode, mask.width_deg) == ("fill", 0.0)
    for (azimuth, elevation), (wanted_azimuth, wanted_elevation) in zip(mask.points, corners, strict=True):
        assert abs(azimuth - wanted_azimuth) < 1.5
        assert abs(elevation - wanted_elevation) < 1.0
    eventually(lambda: "1 mask" in page.locator("#sky-facts").inner_text(), "words for it")

    # Darker, moved as a whole, back, and there again.
    page.locator("#item-mode").select_option("dark")
    eventually(lambda: masks(simulated)[0].mode == "dark", "the other mode")
    tool(page, "Select")
    drag(page, place(page, 120, 35), place(page, 200, 35))
    shift = on_disc(200, 35) - on_disc(120, 35)
    wanted = [on_disc(*point) + shift for point in mask.points]
    eventually(lambda: max(abs(on_disc(*p) - w) for p, w in zip(masks(simulated)[0].points, wanted, strict=True)) < 1.5, "the move")
    moved = masks(simulated)[0]
    page.locator("#disc").press("Control+z")
    eventually(lambda: masks(simulated)[0].points == mask.points, "the place before")
    page.locator("#disc").press("Control+Shift+z")
    eventually(lambda: masks(simulated)[0] == moved, "moved again")
    for _ in range(3):
        page.locator("#undo").click()
    eventually(lambda: newest(simulated).masks is None, "no choice, as before")
    assert page.locator("#undo").is_disabled()
    assert page.locator("#sky-items").is_hidden()


def test_a_brush_paints_a_stroke_and_a_key_removes_it(page, simulated):
    tool(page, "Brush")
    page.locator("#mask-mode").select_option("dark")
    page.locator("#brush-width").fill("12")
    drag(page, place(page, 250, 30), place(page, 290, 30))
    (mask,) = eventually(lambda: newest(simulated).masks, "the stroke")
    assert (mask.mode, mask.width_deg) == ("dark", 12.0)
    assert 2 <= len(mask.points) <= 64
    page.locator("#disc").press("Delete")
    eventually(lambda: newest(simulated).masks == (), "none: not even the settings' own")


def test_a_lamp_is_dragged_out_turned_and_dimmed(page, simulated):
    tool(page, "Lamp")
    drag(page, place(page, 45, 60), place(page, 45, 50))
    (lamp,) = eventually(lambda: newest(simulated).lamps, "the lamp")
    assert lamp.id == 1
    assert lamp.azimuth_deg == pytest.approx(45, abs=2)
    assert lamp.elevation_deg == pytest.approx(60, abs=1)
    assert lamp.size_deg == pytest.approx(20, abs=2)
    assert lamp.irradiance[0] == lamp.irradiance[2] > 0

    page.locator("#lamp-level").fill("2.5")
    page.locator("#lamp-colour").fill("#ff0000")
    eventually(lambda: lamps(simulated)[0].irradiance == (2.5, 0.0, 0.0), "red light")
    drag(page, place(page, lamp.azimuth_deg, lamp.elevation_deg), place(page, 180, 30))
    eventually(lambda: abs(lamps(simulated)[0].elevation_deg - 30) < 1.5, "the lamp moved")
    assert lamps(simulated)[0].azimuth_deg == pytest.approx(180, abs=3)
    page.locator("#disc").press("Delete")
    eventually(lambda: newest(simulated).lamps == (), "no lamp")
    page.locator("#undo").click()
    eventually(lambda: newest(simulated).lamps, "the lamp again")


def test_everything_by_keys(page, simulated):
    disc = page.locator("#disc")
    tool(page, "Polygon")
    disc.focus()
    for keys in (["Shift+ArrowUp", "Shift+ArrowUp"], ["Shift+ArrowRight", "Shift+ArrowRight"], ["Shift+ArrowDown", "Shift+ArrowDown"]):
        for key in [*keys, "Enter"]:
            page.keyboard.press(key)
    page.keyboard.press("Enter")  # where the last corner is: closes it
    (mask,) = eventually(lambda: newest(simulated).masks, "the mask")
    assert mask.points[0] == pytest.approx((90.0, 70.0), abs=0.1)
    tool(page, "Lamp")
    disc.focus()
    page.keyboard.press("Enter")
    (lamp,) = eventually(lambda: newest(simulated).lamps, "the lamp")
    page.keyboard.press("ArrowUp")
    eventually(lambda: lamps(simulated)[0].elevation_deg != lamp.elevation_deg, "the lamp moved")
    page.keyboard.press("Backspace")
    eventually(lambda: newest(simulated).lamps == (), "no lamp")


def test_an_object_goes_back_and_forth_by_name(page, simulated):
    page.locator("#object").select_option("box")
    page.locator("#object-x").fill("3")
    eventually(lambda: newest(simulated).poses and newest(simulated).poses[0].position[0] == 3, "the box moved")
    page.locator("#exposure").fill("1.5")
    eventually(lambda: newest(simulated).exposure == 1.5, "the exposure")
    undo = page.locator("#undo")
    assert undo.get_attribute("aria-label") == "Undo: exposure"
    undo.click()
    eventually(lambda: newest(simulated).exposure is None, "the exposure as before")
    assert undo.get_attribute("aria-label") == "Undo: moved box"
    undo.click()
    eventually(lambda: newest(simulated).poses == (), "the box as before")
    eventually(lambda: page.locator("#object-x").input_value() == "1", "its number shown")
    assert page.locator("#hands-said").inner_text() == "Undid: moved box"
    page.locator("#redo").click()
    page.locator("#redo").click()
    eventually(lambda: newest(simulated).exposure == 1.5 and newest(simulated).poses[0].position[0] == 3, "both again")


def test_a_drag_is_one_entry_however_long_it_takes_and_a_field_shows_what_was_undone(page, simulated):
    slider = page.locator("#exposure")
    slider.scroll_into_view_if_needed()
    box = slider.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    for part in (0.6, 0.7):
        page.mouse.move(box["x"] + part * box["width"], box["y"] + box["height"] / 2)
        page.wait_for_timeout(1000)  # longer than choices of one kind count as one
    page.mouse.up()
    eventually(lambda: (newest(simulated).exposure or 0) > 2, "the exposure")
    page.keyboard.press("Control+z")
    eventually(lambda: newest(simulated).exposure is None, "one entry")
    assert page.locator("#undo").is_disabled()

    page.locator("#object").select_option("box")
    page.locator("#object-x").fill("3")
    eventually(lambda: newest(simulated).poses, "the box moved")
    page.locator("#object-x").press("Control+z")
    eventually(lambda: newest(simulated).poses == (), "the box back")
    assert page.locator("#object-x").input_value() == "1"


def test_arming_and_pausing_are_no_entries(page, simulated):
    page.get_by_role("button", name="Pause").click()
    eventually(lambda: newest(simulated).paused, "the pause")
    assert page.locator("#undo").is_disabled()
    page.get_by_role("button", name="Resume").click()
    eventually(lambda: not newest(simulated).paused, "the end of the pause")


def test_what_is_seen_is_saved(page, simulated, folder):
    tool(page, "Lamp")
    page.mouse.click(*place(page, 10, 40))
    page.locator("#exposure").fill("-1")
    eventually(lambda: newest(simulated).exposure == -1 and newest(simulated).lamps, "both choices")
    with page.expect_download() as download:
        page.locator("#save-settings").click()
    content = Path(download.value.path()).read_bytes()
    assert download.value.suggested_filename == "vemlight.toml"
    saved = record_from_toml("vemlight.toml", content, Settings)
    assert saved.renderer.exposure == -1
    assert saved.sampler.lamp == newest(simulated).lamps
    assert tomllib.loads(content.decode())["wire"] == {"folder": str(folder)}  # as the settings have it


def test_the_sky_has_numbers(page):
    page.mouse.move(*place(page, 30, 5))
    text = page.locator("#sky-values")
    eventually(lambda: "in the map's unit" in text.inner_text(), "a luminance")
    value = text.inner_text()
    assert value.startswith(("Azimuth 29°", "Azimuth 30°", "Azimuth 31°"))
    luminance = 0.2126 * 0.3 + 0.7152 * 0.5 + 0.0722 * 0.9  # of the made-up sky
    assert f"{luminance:.3g} in the map's unit" in value
    status, values = page.viewer.get("/sky.bin")
    assert status == 200
    assert len(values) == struct.calcsize("<4s4Hff") + 4 * 18 * 72
    page.locator("#disc").focus()
    page.keyboard.press("ArrowUp")
    eventually(lambda: "Azimuth 90°, elevation 88°" in text.inner_text(), "the direction of the cross")


def test_what_is_too_much_is_refused_with_a_line(page, simulated):
    point = [1.0, 2.0]
    hostile = [
        {"masks": [{"points": [point] * 65}]},
        {"masks": [{"points": [point] * 3}] * 17},
        {"masks": [{"points": [point] * 60, "width_deg": 1}] * 9},
        {"masks": [{"points": [[1.0, 91.0]] * 3}]},
        {"masks": [{"points": [point] * 3, "mode": "delete"}]},
        {"masks": [{"points": [point] * 2}]},
        {"lamps": [{"id": 1, "azimuth_deg": 0, "elevation_deg": 0, "irradiance": [-1, 0, 0]}]},
        {"lamps": [{"id": VIRTUAL_IDS_FROM, "azimuth_deg": 0, "elevation_deg": 0, "irradiance": [1, 1, 1]}]},
        {"lamps": [{"id": 1, "azimuth_deg": 0, "elevation_deg": 0, "irradiance": [1, 1, 1]}] * 2},
        {"poses": [{"name": "box", "position": [0, 0, 0], "scale": 0}]},
    ]
    for choice in hostile:
        status, line = page.viewer.choose(**choice)
        assert (status, line.count(b"\n")) == (400, 1), choice
    status, line = page.viewer.get("/control", b'{"masks": [{"points": [[NaN, 1], [0, 0], [1, 1]]}]}', Content_Type="application/json")
    assert (status, line.count(b"\n")) == (400, 1)
    status, _ = page.viewer.choose(masks=[{"points": [point] * 3}] * 20_000)
    assert status == 413
    assert newest(simulated) == wire.ControlMessage()
    assert page.viewer.choose(masks=[{"points": [[0, 0], [40, 0], [20, 30]]}])[0] == 200
    eventually(lambda: newest(simulated).masks == (Mask(points=((0.0, 0.0), (40.0, 0.0), (20.0, 30.0))),), "one that is none of these")


def test_a_lamp_is_put_while_the_renderer_is_dead(page, simulated):
    simulated.publishing.discard("renderer")
    page.locator("#overall[data-state=silent], #overall[data-state=stalled]").wait_for()
    tool(page, "Lamp")
    page.mouse.click(*place(page, 10, 40))
    eventually(lambda: len(lamps(simulated)) == 1, "the lamp")
    page.keyboard.press("Control+z")
    eventually(lambda: not lamps(simulated), "no lamp")
    assert "renderer" in page.locator("#overall").inner_text()
    simulated.publishing.add("renderer")
    page.locator("#overall[data-state=live]").wait_for()


def test_the_tools_fit_the_window(page):
    width = page.viewport_size["width"]
    tool(page, "Lamp")
    page.mouse.click(*place(page, 10, 40))
    page.locator("#lamp-level").wait_for()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    if width < 640:
        small = page.evaluate(
            """[...document.querySelectorAll(":is(#sky-tools, #sky-items, #sky-item, .tools-hands) :is(button, input, a)")]
                 .filter((e) => e.offsetParent && e.getBoundingClientRect().height < 44).map((e) => e.id || e.textContent)"""
        )
        assert small == []
