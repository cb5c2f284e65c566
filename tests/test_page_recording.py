"""The page of a run over a camera, a stream of this machine: recorded by a key, its last seconds looked at again, in a real browser."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from tests.support.browser import CHROMIUM, new_page
from tests.support.processes import LOADED_S, ServiceProcesses, free_port
from tests.support.stream_server import jpeg, serving
from tests.support.viewer_process import eventually
from vemlight.capture.manifest import MANIFEST, read_manifest

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser"),
    pytest.mark.long,  # a run, and seconds of a camera
]
FPS = 8.0
LEAST_S = 3.0  # of the camera, that are looked at again


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("camera")


@pytest.fixture(scope="module")
def page(folder: Path, browser) -> Iterator:
    """The page of a run over a stream whose pictures become brighter and dark again."""
    pictures = [jpeg(np.full((16, 32, 3), 20 + 20 * k, np.uint8)) for k in range(10)]
    port, services = free_port(), ServiceProcesses()
    with serving(pictures, fps=FPS) as server:
        capture = {"source": server.address, "rows": 8, "cols": 32, "recordings": str(folder / "recordings"), "fps": FPS}
        tags = {"transfer": "srgb", "primaries": "bt709", "matrix": "bt601", "range": "full"}
        small = {"sampler": {"count": 8}, "renderer": {"width": 48, "height": 36}, "viewer": {"port": port}}
        (folder / "vemlight.toml").write_text(tomli_w.dumps({"capture": {**capture, **tags}, **small}))
        process = services.start("vemlight", "run", str(folder / "vemlight.toml"))
        assert process.stdout
        process.stdout.readline()  # it listens now
        page = new_page(browser, "desk")
        page.set_default_timeout(1e3 * LOADED_S)
        page.goto(f"http://127.0.0.1:{port}")
        page.locator("#overall[data-state=live]").wait_for()
        yield page
        page.context.close()
        process.terminate()
        process.wait(30)
        services.kill()


def source(page) -> dict:
    return page.request.get(f"{page.url}healthz").json()["source"]


def recorded(folder: Path) -> list[Path]:
    return sorted((folder / "recordings").glob("2*"))


def test_a_key_records_the_camera_and_ends_it(page, folder):
    assert page.locator("#place").inner_text() == "live"
    assert page.locator("#strip").is_hidden()
    page.locator("#record-facts", has_text="are free").wait_for()
    page.locator("#record").focus()
    page.keyboard.press("Enter")
    page.locator("#record[aria-pressed=true]").wait_for()
    assert "on" in page.locator("#record-light").get_attribute("class").split()
    eventually(lambda: source(page)["recorded_frames"] >= 2 * FPS, "two seconds")
    page.locator("#record-facts", has_text=" frames, ").wait_for()
    page.locator("#record").click()
    page.locator("#record[aria-pressed=false]").wait_for()
    assert "on" not in page.locator("#record-light").get_attribute("class").split()
    (made,) = recorded(folder)
    eventually(lambda: (made / MANIFEST).exists() and len(read_manifest(made)) >= 2 * FPS, "what the manifest says")
    assert page.locator("#undo").is_disabled()  # nothing is recorded, or deleted, by going back


def test_the_last_seconds_are_looked_at_again_while_the_camera_rests(page):
    eventually(lambda: source(page)["recent_s"] >= LEAST_S, "seconds in memory")
    page.locator("#look-again").click()
    eventually(lambda: source(page)["choice"] == "recent", "the last seconds")
    page.locator("#look-again").wait_for(state="hidden")
    assert source(page)["frames"] >= LEAST_S * FPS / 2
    page.locator("#strip").focus()
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")  # pauses
    eventually(lambda: source(page)["position"] == 1, "the second frame")
    page.keyboard.press("Space")
    page.locator("#record-facts", has_text="only cameras and streams").wait_for()
    page.locator("#source-list input[value='']").check()
    eventually(lambda: source(page)["choice"] is None, "the camera again")
    page.locator("#place", has_text="live").wait_for()
    page.locator("#overall[data-state=live]").wait_for()


def test_a_recording_plays_and_another_source_ends_what_is_recorded(page, folder):
    page.locator("#record").click()
    page.locator("#record[aria-pressed=true]").wait_for()
    eventually(lambda: source(page)["recorded_frames"] >= FPS, "a second")
    first, second = recorded(folder)
    page.locator(f"input[value='recording {first.name}']").check()
    eventually(lambda: source(page)["choice"] == f"recording {first.name}", "the recording")
    eventually(lambda: source(page)["frames"] == len(read_manifest(first)), "all its frames")
    page.locator("#record[aria-pressed=false]").wait_for()
    assert page.locator("#source-refusal").inner_text() == ""
    page.locator("#undo").click()
    eventually(lambda: source(page)["choice"] is None, "the camera again")
    page.locator("#overall[data-state=live]").wait_for()
    assert source(page)["recording"] == ""
    assert len(read_manifest(second)) >= FPS
    assert recorded(folder) == [first, second]


def test_the_page_logged_no_error(page):
    assert page.complaints == []
