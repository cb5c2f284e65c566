"""The page in a real browser: frames arrive, controls act, silence shows, nothing is asked of anybody else."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.support.browser import CHROMIUM, with_summary
from tests.support.viewer_process import PATIENCE_S, SimulatedServices, ViewerProcess, eventually
from vemlight.light.sphere import quaternion_xyz
from vemlight.runtime import wire
from vemlight.settings import Wire
from vemlight.viewer.web import BINARY_FEEDS

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    folder.chmod(0o700)
    return folder


@pytest.fixture(scope="module")
def simulated(folder: Path) -> Iterator[SimulatedServices]:
    simulated = SimulatedServices(Wire(folder=str(folder)))
    simulated.publishing = set()
    simulated.start()
    yield simulated
    simulated.end()


@pytest.fixture(scope="module")
def page(folder: Path, simulated: SimulatedServices, browser) -> Iterator:
    """The page before anything was received; then the services publish."""
    viewer = ViewerProcess(folder)
    viewer.first_line()
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(PATIENCE_S * 1e3)
    page.asked, page.complaints = [], []
    page.on("request", lambda request: page.asked.append(request.url))
    page.on("console", lambda message: page.complaints.append(message.text))
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    page.viewer = viewer
    page.goto(viewer.url)
    page.get_by_text("waiting for capture …").wait_for()
    page.get_by_text("waiting for renderer …").wait_for()
    simulated.publishing = {"capture", "sampler", "renderer"}
    page.locator("#overall[data-state=live]").wait_for()
    eventually(lambda: simulated.controls, "a first control, without choices")
    yield page
    viewer.end()


def shown(page, canvas: str) -> int:
    return int(page.locator(canvas).get_attribute("data-shown") or 0)


def pixel(page, canvas: str, x: float, y: float) -> list[int]:
    """Red, green, blue at a place of the canvas, in parts of its size."""
    return page.evaluate(
        """([canvas, x, y]) => {
            const c = document.querySelector(canvas);
            return [...c.getContext("2d").getImageData(Math.floor(x * c.width), Math.floor(y * c.height), 1, 1).data.slice(0, 3)];
        }""",
        [canvas, x, y],
    )


def test_frames_arrive(page):
    for canvas in ("#disc", "#picture"):
        before = shown(page, canvas)
        eventually(lambda canvas=canvas, before=before: shown(page, canvas) > before + 10, f"frames on {canvas}")
    red, green, blue = pixel(page, "#picture", 0.99, 0.5)
    assert min(red, green, blue) > 200 or red > 200  # white, or the red bar just there
    red, green, blue = pixel(page, "#disc", 0.3, 0.85)  # beyond the lights
    assert blue > red > 0  # the made-up sky is blue
    assert page.locator("#sky-facts").inner_text().startswith("72 lights")
    assert page.locator("#sky-cover").is_hidden()
    assert page.locator("#scene-cover").is_hidden()


def test_the_slider_is_published(page, simulated):
    page.locator("#count").fill("100")  # the slider's own scale: 10 ** (100 / 100)
    eventually(lambda: simulated.controls and simulated.controls[-1].count == 10, "the choice of 10 lights")
    page.get_by_text("10 lights").wait_for()
    page.locator("#count").focus()
    page.keyboard.press("End")
    eventually(lambda: simulated.controls[-1].count == 1000, "the choice of 1000 lights, by the keyboard")
    page.locator("#count-number").fill("72")
    page.keyboard.press("Enter")
    eventually(lambda: simulated.controls[-1].count == 72, "the choice of 72 lights, by its number")


def test_the_other_controls_are_published_together(page, simulated):
    page.locator("#exposure").fill("-1.5")
    page.locator("#filtered").click()
    page.get_by_role("button", name="Pause").click()
    eventually(lambda: simulated.controls[-1] == wire.ControlMessage(count=72, exposure=-1.5, filtered=False, paused=True), "all of them")
    page.locator("#sky-cover").get_by_text("paused at this frame").wait_for()
    page.get_by_role("button", name="Resume").click()
    page.get_by_role("button", name="Reset to settings").click()
    eventually(lambda: simulated.controls[-1] == wire.ControlMessage(), "the settings' own again")
    eventually(lambda: page.locator("#exposure").input_value() == "0" and page.locator("#filtered").is_checked(), "the settings shown")


def test_a_lamp_is_moved_turned_and_dimmed(page, simulated):
    assert page.locator("#object").input_value() == "lamp"  # lamps are what one moves first
    assert page.locator("#object-about-x").input_value() == "180"
    page.locator("#object-x").fill("-0.25")
    page.locator("#object-about-z").fill("90")
    page.locator("#object-power").fill("3")
    eventually(lambda: simulated.controls[-1].poses and simulated.controls[-1].poses[0].power == 3.0, "the lamp's power")
    (lamp,) = simulated.controls[-1].poses
    assert (lamp.name, lamp.position) == ("lamp", (-0.25, 0.0, 2.0))
    assert np.allclose(lamp.rotation, quaternion_xyz((180.0, 0.0, 90.0)), atol=1e-6)
    page.locator("#object").select_option("box")
    assert page.locator("#object-power").is_hidden()
    page.locator("#object-y").fill("2")
    eventually(lambda: len(simulated.controls[-1].poses) == 2, "both")
    page.get_by_role("button", name="Reset to scene file").click()
    eventually(lambda: simulated.controls[-1].poses == (lamp,), "the box back")
    page.locator("#object").select_option("lamp")
    page.get_by_role("button", name="Reset to scene file").click()
    eventually(lambda: simulated.controls[-1] == wire.ControlMessage(), "all back")


ROTATIONS = [(0, 0, 0), (30, -40, 170), (180, 0, 90), (-90, 89, 10), (20, 90, 50), (20, -90, 50), (725, 12, -300), (0, 95, 0), (0, -120, 3)]


@pytest.mark.parametrize("degrees", ROTATIONS)
def test_turns_go_there_and_back(page, degrees):
    turn, again, shown = page.evaluate(
        """async (degrees) => {
            const { rotationFromAngles, anglesFromRotation } = await import("/objects.js");
            const rotation = rotationFromAngles(degrees), angles = anglesFromRotation(rotation);
            return [rotation, rotationFromAngles(angles), angles];
        }""",
        degrees,
    )
    if degrees in ((0, 95, 0), (30, -40, 170)):
        assert np.allclose(shown, degrees)
    assert np.allclose(turn, quaternion_xyz(degrees), atol=1e-9)
    assert abs(np.dot(turn, again)) == pytest.approx(1, abs=1e-9)  # q and -q are the same turn


def test_two_pages_show_the_same(page, browser, simulated):
    second = browser.new_page()
    second.goto(page.viewer.url)
    second.locator("#overall[data-state=live]").wait_for()
    second.locator("#count").fill("150")
    eventually(lambda: page.locator("#count-number").input_value() == "32", "the other page's choice")
    second.close()
    page.viewer.choose(count=None)


def test_a_killed_renderer_shows_as_such_and_comes_back(page, simulated):
    simulated.publishing.discard("renderer")
    page.locator("#card-renderer[data-state=silent]").get_by_text("silent for").wait_for()
    page.locator("#scene-cover").get_by_text("renderer: silent").wait_for()
    assert page.locator("#overall").inner_text() == "renderer silent"
    assert page.locator("#card-capture").get_attribute("data-state") == "live"
    simulated.publishing.add("renderer")
    page.locator("#card-renderer[data-state=live]").wait_for()
    assert page.locator("#scene-cover").is_hidden()


def test_the_light_under_the_pointer_is_described(page):
    box = page.locator("#disc").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)  # light 0 goes round the zenith, 11 pixels away
    eventually(lambda: re.match(r"Light \d+: .* azimuth", page.locator("#light-facts").inner_text()), "words for the light there")


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844), (768, 1024)])
def test_nothing_overflows_the_window(page, width, height):
    page.set_viewport_size({"width": width, "height": height})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    cut = page.evaluate(
        """[...document.querySelectorAll("h2, dt, dd, .pill, label, button, .facts, .under")]
             .filter((e) => e.offsetParent && e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== "inline")
             .map((e) => e.textContent)"""
    )
    assert cut == []
    page.set_viewport_size({"width": 1280, "height": 800})


def test_a_lost_viewer_is_reported_and_found_again(tmp_path, browser):
    tmp_path.chmod(0o700)
    simulated = SimulatedServices(Wire(folder=str(tmp_path)))
    simulated.start()
    viewer = ViewerProcess(tmp_path)
    viewer.first_line()
    page = browser.new_page()
    page.goto(viewer.url)
    eventually(lambda: shown(page, "#picture") > 2, "pictures")
    viewer.end()
    page.get_by_text("The viewer does not answer").wait_for()
    assert page.locator(".pill[data-state=live], article[data-state=live]").count() == 0  # nothing is known of anybody
    again = ViewerProcess(tmp_path, port=viewer.port)
    page.locator("#overall[data-state=live]").wait_for()
    assert page.locator("#notice").is_hidden()
    page.close()
    again.end()
    simulated.end()


def test_a_page_too_many_says_so(page, browser):
    second = browser.new_page()
    second.route_web_socket("**/ws*", lambda route: route.close())
    second.route("**/healthz", lambda route: route.fulfill(json={"pages": 64}))
    second.goto(page.viewer.url)
    second.locator("#notice", has_text="64 pages are open").wait_for()
    second.close()


def test_what_is_stored_or_sent_damaged_does_not_stop_the_page(page, browser):
    second = browser.new_page()
    second.add_init_script("localStorage.setItem('vemlight controls', '{')")

    def with_damage(route) -> None:
        server, damaged = route.connect_to_server(), []

        def onwards(message: str | bytes) -> None:
            if isinstance(message, bytes) and message[0] == BINARY_FEEDS["picture"] and not damaged:
                damaged.append(message)
                message = message[:1] + b"no picture"
            route.send(message)

        server.on_message(onwards)

    second.route_web_socket("**/ws*", with_damage)
    second.goto(page.viewer.url)
    second.locator("#overall[data-state=live]").wait_for()
    eventually(lambda: shown(second, "#picture") > 3, "the pictures after the damaged one")
    assert second.locator("#notice").is_hidden()
    second.close()


def test_choices_outlive_the_viewer(tmp_path, browser):
    tmp_path.chmod(0o700)
    simulated = SimulatedServices(Wire(folder=str(tmp_path)))
    simulated.start()
    viewer = ViewerProcess(tmp_path)
    viewer.first_line()
    pages = [browser.new_context().new_page() for _ in range(2)]  # two people
    for page in pages:
        page.goto(viewer.url)
        page.locator("#overall[data-state=live]").wait_for()
    pages[0].locator("#exposure").fill("-1.5")
    pages[1].locator("#object-x").fill("-0.25")
    whole = eventually(lambda: next((c for c in simulated.controls if c.exposure == -1.5 and c.poses), None), "both choices")

    def known(page) -> bool:  # both choices, of which either may have come first
        kept = page.evaluate("localStorage.getItem('vemlight controls')")
        return "-1.5" in kept and "-0.25" in kept

    eventually(lambda: all(map(known, pages)), "both pages know both")
    for _ in range(3):  # a busy machine's browser may take longer than a viewer waits for its pages
        viewer.end()
        simulated.controls.clear()
        viewer = again = ViewerProcess(tmp_path, port=viewer.port)
        eventually(lambda: simulated.controls, "a control")
        if simulated.controls[0] == whole:
            break
    assert simulated.controls[0] == whole  # not for a moment anything else
    eventually(lambda: pages[1].locator("#exposure").input_value() == "-1.5", "the choice shown")
    pages[0].get_by_role("button", name="Reset to settings").click()
    pages[0].get_by_role("button", name="Reset to scene file").click()
    eventually(lambda: simulated.controls[-1] == wire.ControlMessage(), "the settings' own again")
    again.end()

    simulated.controls.clear()
    third = ViewerProcess(tmp_path, port=viewer.port, more="\n[renderer]\nexposure = 1.0")
    eventually(lambda: simulated.controls, "a control")
    assert set(simulated.controls) == {wire.ControlMessage()}
    eventually(lambda: pages[0].locator("#exposure").input_value() == "1", "the new settings shown")
    third.end()
    for page in pages:
        page.context.close()
    simulated.end()


def test_what_lasts_is_repeated_to_a_viewer_that_starts_again(page):
    repeated = page.evaluate(
        """async () => {
            const { PersistedControls } = await import("/persisted_controls.js"), repeated = [];
            const kept = new PersistedControls((control) => repeated.push(control));
            [kept.read, kept.write] = [() => kept.text, (text) => { kept.text = text; }];
            const none = { count: null, filtered: null, paused: false, source: null, in_s: null, out_s: null, speed: null, poses: [] };
            const take = (started_s, control) => kept.take({ started_s, mode: "live", settings: {}, control: { ...none, ...control } });
            const chosen = [{ filtered: false }, { source: "recording dusk", in_s: 1 }, { source: "upload 0", in_s: 1, speed: 2 }, {}];
            chosen.forEach((control, k) => { take(k, control); take(k + 1, {}); });
            const own = (control) => Object.entries(control).filter(([key, value]) => value !== none[key] && key !== "poses");
            return repeated.map((control) => Object.fromEntries(own(control)));
        }"""
    )
    assert repeated == [{"filtered": False}, {"source": "recording dusk", "in_s": 1}, {"speed": 2}]


def test_settings_for_this_machine_are_found_from_the_guide(page, browser):
    second, told, asked = browser.new_page(), {"state": "idle", "text": ""}, []

    def answer(route) -> None:
        asked.append(route.request.method)
        told.update(state="running", text="640 x 480: 3.1 pictures a second")
        route.fulfill(status=202)

    second.route("**/measure", answer)
    second.route_web_socket("**/ws*", lambda route: with_summary(route, {"measuring": told}))
    second.goto(page.viewer.url)
    second.locator("#guide-next").click()
    key, said = second.locator("#measure"), second.locator("#measure-said")
    assert "two to five minutes" in said.inner_text()
    key.click()
    second.locator("#measure-said", has_text="640 x 480: 3.1 pictures a second …").wait_for()
    second.locator("#overall", has_text="measuring this machine").wait_for()
    assert (asked, key.inner_text()) == (["POST"], "Stop")
    key.click()
    eventually(lambda: asked == ["POST", "DELETE"], "the wish to stop")
    told.update(state="done", text="480 x 270: 9.1 pictures a second")
    second.locator("#measured").wait_for()
    assert said.inner_text() == "Found: 480 x 270: 9.1 pictures a second."
    assert second.locator("#measured").get_attribute("href") == "/measured.toml"
    told.update(state="failed", text="OpenGL: does not start")
    second.locator("#measure-said", has_text="Nothing was found: OpenGL: does not start").wait_for()
    assert second.locator("#measured").is_hidden()
    second.unroute("**/measure")
    second.route("**/measure", lambda route: route.fulfill(status=400, body="measure: a camera serves one run at a time\n"))
    key.click()
    second.locator("#measure-said", has_text="Not now: a camera serves one run at a time").wait_for()
    second.close()


def test_the_page_behind_a_token(tmp_path, browser):
    tmp_path.chmod(0o700)
    simulated = SimulatedServices(Wire(folder=str(tmp_path)))
    simulated.start()
    viewer = ViewerProcess(tmp_path, more='token = "0123456789abcdef"')
    viewer.first_line()
    page = browser.new_context().new_page()
    assert page.goto(viewer.url).status == 401
    page.goto(f"{viewer.url}/?token=0123456789abcdef")
    assert page.url == f"{viewer.url}/"
    eventually(lambda: shown(page, "#picture") > 2, "pictures")
    page.locator("#exposure").fill("-2")
    eventually(lambda: simulated.controls and simulated.controls[-1].exposure == -2, "the choice")
    viewer.end()
    again = ViewerProcess(tmp_path, port=viewer.port, more='token = "fedcba9876543210"')
    page.get_by_text("The viewer has a new token").wait_for()
    page.goto(f"{viewer.url}/?token=fedcba9876543210")
    page.locator("#overall[data-state=live]").wait_for()
    again.end()
    page.context.close()
    simulated.end()


def test_a_filter_that_the_settings_leave_out_says_so(tmp_path, browser):
    tmp_path.chmod(0o700)
    viewer = ViewerProcess(tmp_path, more='[sampler]\nfilter = "none"')
    viewer.first_line()
    page = browser.new_page()
    page.goto(viewer.url)
    page.locator("#filter-effect", has_text='no effect: [sampler] filter is "none"').wait_for()
    assert not page.locator("#filtered").is_checked()
    page.close()
    viewer.end()


def test_lossless_mode_says_why_nothing_can_be_changed(tmp_path, browser):
    tmp_path.chmod(0o700)
    viewer = ViewerProcess(tmp_path, top='mode = "lossless"')
    viewer.first_line()
    page = browser.new_page()
    page.goto(viewer.url)
    page.locator("#no-controls").get_by_text("lossless mode").wait_for()
    assert page.locator("#count").is_disabled()
    assert page.get_by_role("button", name="Pause").is_disabled()
    page.close()
    viewer.end()


def test_the_page_asked_no_other_host_and_logged_no_error(page):
    assert all(url.startswith((page.viewer.url, page.viewer.url.replace("http", "ws"))) for url in page.asked)
    assert page.complaints == []
