"""The fixtures on the page, in a real browser: the rig, the levels, arming with a question, the stop and the blackout key."""

import json
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from tests.support.browser import CHROMIUM
from tests.support.fixture_rigs import beam, dome, rig_of
from tests.support.viewer_process import MAKERS, PATIENCE_S, SimulatedServices, ViewerProcess, eventually, frames_of
from vemlight.fixtures.levels import initial_state
from vemlight.fixtures.stage import FixturesStage
from vemlight.light.light_set import LightSet
from vemlight.runtime import wire
from vemlight.runtime.channels import Service
from vemlight.settings import Settings, Viewer, Wire
from vemlight.viewer.viewer_state import NO_ARMING, ViewerState

needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")
STAGE = FixturesStage(rig_of([beam(k, d) for k, d in enumerate(dome(8))], gain=9.0))


class Sending:
    """What the simulated fixtures say of their packets: as the controls ask."""

    armed = dark = 0


def frames(sequence: int, count: int = 72) -> dict[Service, wire.Message]:
    made = frames_of(sequence, count)
    header, arrays = made["sampler"]
    assert isinstance(header, wire.LightsMessage)
    _, solved = STAGE.step(initial_state(STAGE.system), LightSet(*arrays[:3]), header.stamp)
    report = msgspec.structs.replace(solved.header.report, armed=Sending.armed, blackout=Sending.dark)
    return {**made, "fixtures": (msgspec.structs.replace(solved.header, report=report), solved.arrays)}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> Iterator[tuple[SimulatedServices, ViewerProcess]]:
    folder = tmp_path_factory.mktemp("page")
    folder.chmod(0o700)
    made = SimulatedServices(Wire(folder=str(folder)), frames, (*MAKERS, "fixtures"))
    made.start()
    viewer = ViewerProcess(folder, more='[fixtures]\nrig = "rig.toml"')
    viewer.first_line()
    yield made, viewer
    viewer.end()
    made.end()


@pytest.fixture(scope="module")
def page(simulated, browser) -> Iterator:
    page = browser.new_page(viewport={"width": 1280, "height": 1200})
    page.set_default_timeout(PATIENCE_S * 1e3)
    page.complaints = []
    page.on("console", lambda message: page.complaints.append(message.text))
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    page.goto(simulated[1].url)
    page.locator("#rig[data-shown]").wait_for()
    yield page
    page.close()


def lit_pixels(page, canvas: str) -> int:
    return page.evaluate(
        """(id) => {
            const c = document.querySelector(id), data = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
            let lit = 0;
            for (let k = 3; k < data.length; k += 4) lit += data[k] > 40;
            return lit;
        }""",
        canvas,
    )


@needs_browser
def test_the_rig_and_its_levels_are_drawn(page):
    eventually(lambda: lit_pixels(page, "#rig") > 2000, "the rig")
    eventually(lambda: lit_pixels(page, "#levels") > 200, "the levels")
    text = page.locator("#fixtures-text").inner_text()
    assert "light" in text
    before = page.locator("#rig").screenshot()
    page.locator("#rig").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowUp")
    assert page.locator("#rig").screenshot() != before


@needs_browser
def test_arming_asks_first_and_stopping_does_not(page, simulated):
    services, _ = simulated
    page.get_by_text("preview, nothing is live").wait_for()
    assert page.locator("#stop").is_disabled()
    page.locator("#arm").click()
    page.locator("#arm-cancel").click()
    page.locator("#arm").click()
    assert all(control.armed is None for control in services.controls)
    page.locator("#arm-now").click()
    eventually(lambda: services.controls and services.controls[-1].armed, "the choice to arm")
    Sending.armed = 1
    page.get_by_text("armed: live").wait_for()
    assert page.locator("#arm").is_disabled()

    page.locator("#blackout").click()
    eventually(lambda: services.controls[-1].blackout is True, "the choice of darkness")
    Sending.dark = 1
    page.get_by_text("armed, dark").wait_for()
    page.locator("#rig").focus()
    page.keyboard.press("Shift+B")
    eventually(lambda: services.controls[-1].blackout is False, "the key for light again")
    Sending.dark = 0

    page.locator("#stop").click()
    eventually(lambda: services.controls[-1].armed is False, "the stop")
    Sending.armed = 0
    page.get_by_text("preview, nothing is live").wait_for()
    stored = page.evaluate("localStorage.getItem('vemlight controls')")
    assert "armed" not in stored
    assert page.complaints == []


def test_levels_are_served_as_json(simulated):
    _, viewer = simulated
    eventually(lambda: viewer.get("/levels")[0] == 200, "levels")
    made = json.loads(viewer.get("/levels")[1])
    assert made["schema"] == "vemlight.levels/1"
    assert [fixture["name"] for fixture in made["fixtures"]] == [f"beam {k}" for k in range(8)]
    assert all(len(fixture["levels"]) == 3 for fixture in made["fixtures"])
    assert np.linalg.norm(made["unmatched_at"]) == pytest.approx(1, abs=1e-6)
    rows = viewer.health()["services"]
    assert next(row for row in rows if row["service"] == "fixtures")["state"] == "live"
    assert b"vemlight_fixtures_unmatched_ratio" in viewer.get("/metrics")[1]


@pytest.mark.parametrize(("viewer", "refused"), [
    (Viewer(), False),  # this machine only
    (Viewer(host="0.0.0.0", token="0123456789abcdef"), False),
    (Viewer(host="0.0.0.0", insecure=True), True),
])  # fmt: skip
def test_who_has_no_token_may_not_arm_from_elsewhere(viewer, refused):
    settings = msgspec.convert({"fixtures": {"rig": "rig.toml"}}, Settings)
    state = ViewerState(msgspec.structs.replace(settings, viewer=viewer), 0)
    if refused:
        with pytest.raises(ValueError, match="has no token"):
            state.set_control(b'{"armed": true}')
        assert state.control.armed is None
        assert state.why_not_arm == NO_ARMING
    else:
        state.set_control(b'{"armed": true}')
        assert state.control.armed is True
    state.set_control(b'{"armed": false, "blackout": true}')  # stopping and darkness are everybody's
    assert (state.control.armed, state.control.blackout) == (False, True)


def test_without_a_rig_nothing_can_be_armed():
    with pytest.raises(ValueError, match="no fixtures"):
        ViewerState(Settings(), 0).set_control(b'{"armed": true}')
