"""The page's timeline, graphs and source picker in a real browser, over a whole run: what hands do there, and what comes of it."""

import base64
import os
import signal
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import tomli_w

from tests.support.browser import CHROMIUM, WINDOWS, new_page
from tests.support.processes import ServiceProcesses, children, free_port
from tests.support.viewer_process import eventually
from vemlight.light.images import write_exr

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")

FRAMES = 40
START_MS = 240_000  # compiling, on a loaded machine
PATIENCE_MS = 60_000
READ_HERE = ("400 (Bad Request)", "409", "willReadFrequently")  # of a console: what was refused, and what tests read of canvases
DROP = """([selector, files]) => {
    const data = new DataTransfer();
    for (const [name, content] of files) data.items.add(new File([Uint8Array.from(atob(content), (c) => c.charCodeAt(0))], name));
    for (const type of ["dragenter", "dragover", "drop"])
        document.querySelector(selector).dispatchEvent(new DragEvent(type, { bubbles: true, cancelable: true, dataTransfer: data }));
}"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Settings beside a sequence of FRAMES maps, in which a light goes down one row a frame, and a recordings folder."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "sequence").mkdir()
    (folder / "recordings" / "dusk").mkdir(parents=True)
    for k in range(FRAMES):
        image = np.full((44, 88, 3), 0.2 + 0.02 * k, np.float32)
        image[k // 2 : k // 2 + 2, 20:24] = 90.0
        write_exr(folder / "sequence" / f"sky_{k:03d}.exr", image)
        if k < 3:
            write_exr(folder / "recordings" / "dusk" / f"dusk_{k}.exr", image[:, ::-1].copy())
    (folder / "recordings" / "broken.hdr").write_bytes(b"no picture")
    return folder


class Run(NamedTuple):
    """`vemlight run`: where its page is, and its process."""

    address: str
    pid: int


@pytest.fixture(scope="module")
def run(folder: Path) -> Iterator[Run]:
    """Over the sequence, without cameras."""
    port, services = free_port(), ServiceProcesses()
    (folder / "vemlight.toml").write_text(
        tomli_w.dumps(
            {
                "capture": {"source": "sequence", "fps": 10.0, "rows": 16, "cols": 64, "recordings": "recordings"},
                "sampler": {"count": 8},
                "renderer": {"width": 48, "height": 36},
                "viewer": {"port": port, "uploads_mb": 2},
            }
        )
    )
    process = services.start("vemlight", "run", str(folder / "vemlight.toml"))
    assert process.stdout
    process.stdout.readline()  # it listens now
    yield Run(f"http://127.0.0.1:{port}", process.pid)
    process.terminate()
    process.wait(30)
    services.kill()


@pytest.fixture(scope="module", params=WINDOWS)
def page(run: Run, browser, request) -> Iterator:
    """The page of each size, one after the other, of one run."""
    page = new_page(browser, request.param)
    page.set_default_timeout(PATIENCE_MS)
    page.goto(run.address)
    page.locator("#timeline").wait_for(timeout=START_MS)
    page.locator("#overall[data-state=live]").wait_for(timeout=START_MS)
    yield page
    page.context.close()


def summary(page) -> dict:
    return page.request.get(f"{page.url}healthz").json()


def position(page) -> int:
    return summary(page)["source"]["position"]


def control(page) -> dict:
    return summary(page)["control"]


def file_of(image: np.ndarray, folder: Path) -> str:
    write_exr(folder / "dropped.exr", image)
    return base64.b64encode((folder / "dropped.exr").read_bytes()).decode()


def test_thumbnails_show_the_frames(page):
    eventually(
        lambda: len(summary(page)["source"]["thumbnails"]) == FRAMES, "all thumbnails", 1e-3 * START_MS
    )  # in the time that playing leaves
    lit = "(c) => [...c.getContext('2d').getImageData(0, 0, c.width, c.height - 20).data].filter((v, k) => k % 4 < 3 && v > 40).length"
    eventually(lambda: page.locator("#strip-canvas").evaluate(lit) > 10_000, "discs on the strip")


def test_space_pauses_and_plays(page):
    page.locator("#strip").focus()
    page.keyboard.press("Space")
    eventually(lambda: control(page)["paused"], "the pause")
    page.wait_for_timeout(1000)  # the frame that was due is still shown
    before = position(page)
    page.wait_for_timeout(1000)
    assert position(page) == before
    assert page.locator("#play").get_attribute("aria-label") == "Play"


def test_arrows_step_and_home_and_end_go_to_the_ends(page):
    page.locator("#strip").focus()
    for key, frame in (("Home", 0), ("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("End", FRAMES - 1)):
        page.keyboard.press(key)
        eventually(lambda frame=frame: position(page) == frame, f"frame {frame}")
        assert page.locator("#place").inner_text().startswith(f"frame {frame} of {FRAMES}")
        assert page.locator("#strip").get_attribute("aria-valuenow") == str(frame)


def test_steps_in_quick_succession_are_all_counted_from_a_play_too(page):
    page.locator("#strip").focus()
    page.keyboard.press("Space")
    eventually(lambda: not control(page)["paused"], "playing")
    page.keyboard.press("Home")
    for _ in range(12):
        page.keyboard.press("ArrowRight")
    page.wait_for_timeout(1800)  # the page has heard of the pause
    shown = page.locator("#place").inner_text()
    assert shown.startswith(("frame 12 ", "frame 13 "))  # one was perhaps played before the first step
    eventually(lambda: f"frame {position(page)} of" in shown, "the same at the capture")


def test_a_drag_seeks(page):
    page.locator("#strip").scroll_into_view_if_needed()
    box = page.locator("#strip").bounding_box()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20, steps=4)
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 20, steps=4)
    page.mouse.up()
    eventually(lambda: position(page) == round(0.75 * (FRAMES - 1)), "the frame that was dragged to")


def test_a_pause_says_how_far_it_has_come(page):
    page.locator("#scene-facts").get_by_text("of 64, error about").wait_for()


def test_brackets_and_handles_set_the_range_and_only_it_is_played(page):
    page.locator("#strip").focus()
    page.keyboard.press("ArrowLeft")  # pauses
    page.keyboard.press("Home")
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("[")
    eventually(lambda: control(page)["in_s"] == pytest.approx(0.4), "the in point")
    page.locator("#strip").scroll_into_view_if_needed()
    box = page.locator("#strip").bounding_box()
    page.mouse.move(box["x"] + box["width"] - 2, box["y"] + box["height"] - 5)  # the handle of the out point
    page.mouse.down()
    page.mouse.move(box["x"] + 10.0 / (FRAMES - 1) * box["width"], box["y"] + box["height"] - 5, steps=6)
    page.mouse.up()
    eventually(lambda: control(page)["out_s"] == pytest.approx(1.0), "the out point")
    page.locator("#play").click()
    played = {position(page) for _ in range(30) if page.wait_for_timeout(100) is None}
    assert played <= set(range(4, 11))
    assert len(played) > 2
    page.locator("#loop").click()
    eventually(lambda: summary(page)["source"]["at_end"], "the end")
    assert position(page) == 10
    page.locator("#loop").click()
    page.locator("#whole").click()
    eventually(lambda: position(page) > 10, "frames behind the out point")


def test_speed_is_chosen_and_slow_motion_is_slow(page):
    page.locator("#speed").select_option("0.25")
    eventually(lambda: control(page)["speed"] == 0.25, "the speed")
    eventually(lambda: next(row for row in summary(page)["services"] if row["service"] == "capture")["rate_hz"] < 5, "2.5 frames a second")
    page.locator("#speed").select_option("1")
    eventually(lambda: control(page)["speed"] is None, "the settings' speed")


def test_a_map_dropped_on_the_sky_plays(page, tmp_path):
    red = np.zeros((32, 64, 3), np.float32)
    red[..., 0] = 1.0
    page.evaluate(DROP, ["#disc", [["red sky.exr", file_of(red, tmp_path)]]])
    page.locator("#upload-state").get_by_text("one picture").wait_for()
    eventually(lambda: (summary(page)["source"]["choice"] or "").startswith("upload "), "the upload plays")
    pixel = "(c) => [...c.getContext('2d').getImageData(c.width / 2, c.height / 3, 1, 1).data]"
    eventually(lambda: (rgb := page.locator("#disc").evaluate(pixel))[0] > 3 * max(rgb[1:3]), "a red sky")
    assert page.locator("#source-list input:checked").get_attribute("value").startswith("upload ")
    page.locator("#place", has_text="one picture").wait_for()
    assert page.locator("#strip").is_hidden()


@pytest.mark.parametrize(
    ("files", "line"),
    [
        ([["sky.hdr", base64.b64encode(b"no picture at all").decode()]], "is no file of a known kind"),
        ([["sky.exr", base64.b64encode(b"\x76\x2f\x31\x01" + bytes(50)).decode()]], "sky.exr"),
        ([["sky.hdr", base64.b64encode(b"#?RADIANCE" + bytes(2_100_000)).decode()]], "MB are too much"),
        ([["sky.hdr", ""]], "is no file of a known kind"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_in_a_line_and_the_source_stays(page, files, line):
    before = summary(page)["source"]["choice"]
    page.evaluate(DROP, ["#disc", files])
    page.locator("#upload-refusal").get_by_text(line).wait_for()
    assert summary(page)["source"]["choice"] == before


def test_a_folder_of_frames_is_a_sequence(page, tmp_path):
    files = [[f"f_{k}.exr", file_of(np.full((16, 32, 3), 1.0 + k, np.float32), tmp_path)] for k in range(4)]
    page.evaluate(DROP, ["body", files])
    page.locator("#upload-state").get_by_text("4 frames").wait_for()
    eventually(lambda: summary(page)["source"]["frames"] == 4, "the four frames")
    page.locator("#source-name").get_by_text("f_0.exr").wait_for()
    page.locator("#strip").wait_for()


def test_a_recording_is_chosen_by_the_keyboard_and_a_broken_one_is_refused(page):
    page.locator("input[value='recording dusk']").focus()
    page.keyboard.press("Space")
    eventually(lambda: summary(page)["source"]["choice"] == "recording dusk", "the recording")
    page.locator("#source-name").get_by_text("dusk").wait_for()
    page.locator("input[value='recording broken.hdr']").check()
    page.locator("#source-refusal").get_by_text("is no Radiance picture").wait_for()
    assert summary(page)["source"]["choice"] == "recording dusk"
    page.locator("#source-list input[value='']").check()
    eventually(lambda: summary(page)["source"]["choice"] is None, "the settings' source")


def test_sources_ranges_and_speeds_are_undone(page):
    page.locator("input[value='recording dusk']").check()
    eventually(lambda: summary(page)["source"]["choice"] == "recording dusk", "the recording")
    assert page.locator("#undo").get_attribute("aria-label") == "Undo: source of light"
    page.keyboard.press("Control+z")
    eventually(lambda: summary(page)["source"]["choice"] is None, "the settings' source again")
    page.keyboard.press("Control+Shift+z")
    eventually(lambda: summary(page)["source"]["choice"] == "recording dusk", "the recording again")
    page.keyboard.press("Control+z")
    eventually(lambda: summary(page)["source"]["choice"] is None and summary(page)["source"]["frames"] == FRAMES, "and back")
    page.locator("#speed").select_option("2")
    page.locator("#strip").focus()
    for key in ("ArrowLeft", "Home", "ArrowRight", "ArrowRight", "["):  # the first pauses
        page.keyboard.press(key)
    eventually(lambda: control(page)["in_s"] == pytest.approx(0.2), "the in point")
    assert page.locator("#undo").get_attribute("aria-label") == "Undo: range that is played"  # stepping and pausing are no entries
    page.locator("#undo").click()
    eventually(lambda: control(page)["in_s"] is None and control(page)["speed"] == 2, "the whole again")
    page.locator("#undo").click()
    eventually(lambda: control(page)["speed"] is None, "the settings' speed again")
    page.locator("#play").click()


def test_a_range_is_of_its_source_and_saved_with_it(page):
    page.locator("#strip").focus()
    for key in ("ArrowLeft", "Home", "ArrowRight", "ArrowRight", "ArrowRight", "["):  # the first pauses
        page.keyboard.press(key)
    eventually(lambda: control(page)["in_s"] == pytest.approx(0.3), "the in point")
    saved = tomllib.loads(page.request.get(f"{page.url}vemlight.toml").text())["capture"]
    assert (saved["start"], saved["end"]) == (3, FRAMES)
    page.locator("input[value='recording dusk']").check()
    eventually(lambda: summary(page)["source"]["choice"] == "recording dusk", "the recording")
    assert control(page)["in_s"] is None
    page.locator("#undo").click()
    eventually(lambda: summary(page)["source"]["choice"] is None and control(page)["in_s"] == pytest.approx(0.3), "both again")
    page.locator("#whole").click()
    page.locator("#play").click()
    eventually(lambda: not control(page)["paused"] and control(page)["in_s"] is None, "the whole plays")


def test_uploads_are_removed_and_give_their_room_back(page):
    while (buttons := page.locator("#source-list button")).count():
        count = buttons.count()
        buttons.first.click()
        eventually(lambda count=count: page.locator("#source-list button").count() < count, "one less")
    assert summary(page)["used_bytes"] == 0


def test_files_are_not_recorded_and_the_page_says_why(page):
    assert page.locator("#record").is_disabled()
    page.locator("#record-facts").get_by_text("only cameras and streams").wait_for()


def test_graphs_show_values_and_a_table_says_them(page):
    drawn = "(c) => [...c.getContext('2d').getImageData(0, 0, c.width, c.height).data].some((v, k) => k % 4 === 3 && v > 0)"
    assert page.locator("#graph-boxes canvas").count() == 6
    if page.locator("#graph-0").is_hidden():  # on a phone they open when they are wanted
        page.locator("#graphs > summary").click()
    for n in range(6):
        eventually(lambda n=n: page.locator(f"#graph-{n}").evaluate(drawn), f"graph {n}")
    page.locator("#graph-1").scroll_into_view_if_needed()
    box = page.locator("#graph-1").bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + box["height"] / 2)
    page.locator("#graphs-when").get_by_text("s ago").wait_for()
    page.mouse.move(0, 0)
    page.locator("#graph-0").focus()
    page.keyboard.press("ArrowLeft")
    page.locator("#graphs-when").get_by_text("0.5 s ago").wait_for()
    page.locator("#graphs-figures > summary").click()
    row = page.locator("#graphs-table tr", has_text="rate, pictures, /s").locator("td").first
    eventually(lambda: float(row.inner_text().replace("–", "nan")) > 0, "a rate in the table")
    page.locator("#graphs-figures > summary").click()


def test_nothing_overflows_and_targets_are_large_enough(page):
    width = page.viewport_size["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    small = page.evaluate(
        """(least) => [...document.querySelectorAll("#transport button, #transport select, #source button, #source-list label, #strip")]
             .filter((e) => e.offsetParent && Math.min(e.offsetHeight, e.tagName === "LABEL" ? 99 : e.offsetWidth) < least)
             .map((e) => e.id || e.textContent)""",
        44 if width < 640 else 36,
    )
    assert small == []


def test_the_timeline_seeks_while_the_renderer_is_dead(page, run):
    renderer = children(run.pid)["renderer"]
    os.kill(renderer, signal.SIGSTOP)
    page.locator("#overall:is([data-state=silent], [data-state=stalled])").wait_for()
    assert page.locator("#overall").inner_text().startswith("renderer ")
    page.locator("#scene-cover", has_text="renderer: ").wait_for()
    page.locator("#strip").focus()
    for key in ("ArrowLeft", "Home", "ArrowRight"):  # the first pauses
        page.keyboard.press(key)
    eventually(lambda: position(page) == 1 and control(page)["paused"], "a step")
    os.kill(renderer, signal.SIGKILL)
    page.locator("#scene-cover", has_text="restarting: it was killed by SIGKILL").wait_for()
    page.locator("#overall[data-state=paused]").wait_for()
    page.keyboard.press("Space")
    page.locator("#overall[data-state=live]").wait_for()


def test_the_page_logged_no_error_but_the_refusals(page):
    assert [line for line in page.complaints if not any(word in line for word in READ_HERE)] == []
