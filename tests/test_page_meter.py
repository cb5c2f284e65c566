"""The page for everyone, in a real browser at three sizes: light meter, guide, themes, states that are true, a heap that stays."""

import math
import os
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.browser import CHROMIUM, SIZES, new_page
from tests.support.page_checks import CONTRAST, NAMES, SIDEWAYS, TARGETS
from tests.support.viewer_process import SimulatedServices, ViewerProcess, eventually, frames_of
from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.runtime import wire
from vemlight.runtime.channels import Service
from vemlight.runtime.reports import ImageReport, MapReport
from vemlight.settings import Wire

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")

SCALE, SKY, BUDGET = 100.0, 10.0, 8  # cd/m2 a unit; radiance of the upper half; lights that the renderer has time for
GROWTH_BYTES = 2**21  # of the heap over GROWTH_S at 25 pictures a second; bench/page_heap.py watches for ten minutes
GROWTH_S = 4.0


class Sky:
    """Whether the simulated camera is calibrated."""

    scale: float | None = SCALE


def frames(sequence: int, count: int = 40) -> dict[Service, wire.Message]:
    """A white sky over darkness, a clipped spot, and a renderer that draws BUDGET lights of those made, without a bounce."""
    made = frames_of(sequence, min(count, 40))
    radiance = np.zeros((36, 72, 3), np.float32)
    radiance[:18] = SKY
    radiance[4, 10], radiance[17, :4] = 50 * SKY, SKY / 100  # the bounds of the false colours
    report = MapReport(saturated_pixels=5)
    stamp = made["capture"][0].stamp  # type: ignore[attr-defined]
    header = wire.MapMessage(stamp=stamp, rows=36, cols=72, coverage="sphere", luminance_scale=Sky.scale, report=report)
    image, pixels = made["renderer"]
    drawn = ImageReport(drawn_lights=min(count, BUDGET), render_ms=90.0, light_budget=BUDGET, bounces_left_out=1)
    return {
        "capture": (header, (radiance, *NO_BRIGHT_CELLS)),
        "sampler": made["sampler"],
        "renderer": (msgspec.structs.replace(image, report=drawn), pixels),
    }


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> Iterator[tuple[SimulatedServices, ViewerProcess]]:
    folder = tmp_path_factory.mktemp("page")
    folder.chmod(0o700)
    made = SimulatedServices(Wire(folder=str(folder)), frames)
    made.start()
    viewer = ViewerProcess(folder)
    viewer.first_line()
    yield made, viewer
    viewer.end()
    made.end()


@pytest.fixture(scope="module")
def pages(simulated, browser) -> Iterator[dict]:
    """One page of each size, whose guide was closed at its first visit; none complains."""
    opened = {}
    for name in SIZES:
        page = new_page(browser, name, color_scheme="dark")
        page.goto(simulated[1].url)
        page.locator("#overall[data-state=live]").wait_for()
        opened[name] = page
    yield opened
    assert [page.complaints for page in opened.values()] == [[]] * len(SIZES)
    for page in opened.values():
        page.context.close()


def test_the_guide_has_three_steps_and_never_comes_back(pages):
    page = pages["desk"]
    guide = page.locator("#guide")
    assert guide.is_visible()
    titles = [page.locator("#guide-title").inner_text()]
    for _ in range(2):
        page.locator("#guide-next").click()
        titles.append(page.locator("#guide-title").inner_text())
    assert titles == ["What you see", "Your light", "Your scene"]
    page.locator("#guide-next").click()
    guide.wait_for(state="hidden")
    page.reload()
    page.locator("#overall[data-state=live]").wait_for()
    assert not guide.is_visible()
    page.locator("#guide-open").focus()
    page.keyboard.press("Enter")
    guide.wait_for()
    page.keyboard.press("Escape")
    guide.wait_for(state="hidden")
    for other in ("small", "phone"):
        pages[other].locator("#guide-close").click()


@pytest.mark.parametrize("size", SIZES)
def test_the_meter_measures_the_plane_that_is_turned(pages, size):
    page = pages[size]
    page.locator("#meter").scroll_into_view_if_needed()
    page.locator("#meter-illuminance", has_text="lx").wait_for()
    assert page.locator("#meter-state").inner_text() == "calibrated, cd/m²"
    lux = lambda: float(page.locator("#meter-illuminance").inner_text().split(" lx")[0].replace("\u202f", ""))  # noqa: E731
    eye = math.pi / 2 * SKY * SCALE
    eventually(lambda: lux() == pytest.approx(eye, rel=0.1), "half of the sky on a wall")
    assert "DGP" in page.locator("#meter-glare").inner_text()
    page.locator("#meter-table").click()
    eventually(lambda: lux() == pytest.approx(2 * eye, rel=0.1), "all of it on a table")
    dial = page.locator("#meter-dial")
    dial.scroll_into_view_if_needed()
    box = dial.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 0.995 * box["height"], steps=4)  # to the rim: the ground
    page.mouse.up()
    eventually(lambda: lux() < 0.05 * eye, "a plane that faces the dark ground")
    assert int(page.locator("#meter-elevation").input_value()) < -80
    page.locator("#meter-eye").click()
    dial.focus()
    before = int(page.locator("#meter-azimuth").input_value())
    page.keyboard.press("ArrowRight")
    assert int(page.locator("#meter-azimuth").input_value()) == (before + 5) % 360
    assert page.locator("#meter-lights tr").count() == 8
    assert "5352 K" in page.locator("#meter-lights").inner_text()  # of (1, 0.9, 0.7), by an independent calculation
    assert "clipped about" in page.locator("#meter-range").inner_text()


def colours(page, canvas: str, x: float, y: float) -> np.ndarray:
    """Red, green, blue, alpha (24 x 24, 4) from a place of a canvas on, in parts of its size."""
    content = page.evaluate(
        """([id, x, y]) => {
            const from = document.getElementById(id), to = new OffscreenCanvas(24, 24).getContext("2d", { willReadFrequently: true });
            to.drawImage(from, -Math.floor(x * from.width), -Math.floor(y * from.height));
            return [...to.getImageData(0, 0, 24, 24).data];
        }""",
        [canvas, x, y],
    )
    return np.array(content).reshape(-1, 4)


def test_false_colours_and_zebra_lie_over_the_sky_and_the_picture(pages):
    page = pages["desk"]
    page.locator("#false-colour").click()
    # The rim of the disc is the dark ground, black in false colours; half way to it is the sky, which is no longer white.
    tinted = lambda: np.mean(np.ptp(colours(page, "disc", 0.5, 0.35)[:, :3], axis=1) > 40)  # noqa: E731
    eventually(lambda: tinted() > 0.3, "a tinted sky, where no light is drawn")
    assert np.median(colours(page, "disc", 0.5, 0.85)[:, :3]) < 30
    assert page.locator("#colour-scale").is_visible()
    assert "cd/m²" in page.locator("#colour-scale").inner_text()
    assert (colours(page, "picture-meter", 0.5, 0.5)[:, 3] == 255).all()
    page.locator("#false-colour").click()
    page.locator("#zebra").click()
    eventually(lambda: np.ptp(colours(page, "disc", 0.5, 0.85), axis=0).max() > 60, "stripes where there is no light")
    eventually(lambda: np.ptp(colours(page, "picture-meter", 0.3, 0.3), axis=0).max() > 60, "stripes where the picture is white")
    page.locator("#zebra").click()
    assert page.locator("#picture-meter").is_hidden()
    assert page.locator("#colour-scale").is_hidden()


def test_a_control_without_effect_says_so_beside_it(pages):
    page = pages["desk"]
    page.locator("#count-effect", has_text="40 asked, 8 drawn: there is no time for more").wait_for()
    assert "frame_ms" in page.locator("#count-effect").inner_text()
    left_out = page.locator("#card-renderer .given-up")
    assert left_out.inner_text() == "Left out for time: 32 of 40 lights, light from surface to surface."
    page.locator("#count-number").fill("8")
    page.keyboard.press("Enter")
    eventually(lambda: page.locator("#count-effect").inner_text() == "", "eight can be drawn")
    eventually(lambda: left_out.inner_text() == "Left out for time: light from surface to surface.", "all eight are")
    page.locator("#reset").click()


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("size", SIZES)
def test_everybody_can_see_name_and_hit_what_is_there(pages, size, theme):
    page = pages[size]
    page.emulate_media(color_scheme=theme, reduced_motion="reduce")
    eventually(lambda: page.evaluate("document.documentElement.dataset.theme") == theme, "the system's theme")
    assert page.evaluate(CONTRAST) == []
    assert page.evaluate(NAMES) == []
    assert page.evaluate(SIDEWAYS) == []
    if size == "phone":
        assert page.evaluate(TARGETS) == []


def test_a_relative_map_takes_its_scale_from_what_a_meter_shows(pages, simulated):
    page = pages["small"]
    page.locator("#meter").scroll_into_view_if_needed()
    Sky.scale = None
    page.locator("#meter-state", has_text="relative").wait_for()
    assert page.locator("#meter-glare").inner_text() == "needs a scale"
    page.locator("#meter-azimuth").fill("210")
    page.locator("#meter-measured").fill("1234")
    page.keyboard.press("Tab")  # at once: the readings shown are still those of another plane
    page.locator("#meter-illuminance", has_text="230 lx").wait_for()  # three digits
    assert "DGP" in page.locator("#meter-glare").inner_text()
    page.locator("#meter-table").click()
    page.locator("#meter-illuminance", has_text="2\u202f").wait_for()  # twice as much, as the whole sky gives
    Sky.scale = SCALE
    page.locator("#meter-state", has_text="calibrated").wait_for()
    assert page.locator("#meter-calibrate").is_hidden()


def test_the_theme_that_is_chosen_stays(pages):
    page = pages["desk"]
    page.emulate_media(color_scheme="dark")
    theme = page.locator("#theme")
    theme.click()
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
    page.reload()
    assert page.evaluate("document.documentElement.dataset.theme") == "light"
    theme.click()
    theme.click()
    assert theme.get_attribute("aria-label") == "Theme: as the system"
    page.locator("#overall[data-state=live]").wait_for()


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_axe_finds_no_violation(pages, theme):
    script = os.environ.get("VEMLIGHT_AXE", "")
    if not script:
        pytest.skip("VEMLIGHT_AXE does not name axe.min.js of the package axe-core: only our own checks were made")
    for page in pages.values():
        page.emulate_media(color_scheme=theme)
        page.evaluate(Path(script).read_text())  # a script element would be refused by the page's security policy
        found = page.evaluate("async () => (await axe.run()).violations.map(({ id, nodes }) => `${id}: ${nodes[0].html.slice(0, 120)}`)")
        assert found == []


def test_the_heap_stays(pages):
    page = pages["desk"]
    page.locator("#false-colour").click()
    page.locator("#meter").scroll_into_view_if_needed()
    session = page.context.new_cdp_session(page)

    def heap() -> int:
        session.send("HeapProfiler.collectGarbage")
        return page.evaluate("performance.memory.usedJSHeapSize")

    page.wait_for_timeout(1500)
    before = heap()
    page.wait_for_timeout(1e3 * GROWTH_S)
    assert heap() - before < GROWTH_BYTES
    page.locator("#false-colour").click()


def test_what_died_is_never_called_live(pages, simulated):
    made, _ = simulated
    made.publishing = {"capture", "sampler"}
    for page in pages.values():
        page.locator("#overall[data-state=stalled], #overall[data-state=silent]").wait_for()
        assert "renderer" in page.locator("#overall").inner_text()
    made.publishing = {"sampler", "renderer"}
    page = pages["desk"]
    page.locator("#meter-state", has_text="last values: capture").wait_for()
    made.publishing = {"capture", "sampler", "renderer"}
    for page in pages.values():
        page.locator("#overall[data-state=live]").wait_for()
    page = pages["desk"]
    page.locator("#meter-state", has_text="calibrated").wait_for()
