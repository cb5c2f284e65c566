"""Pictures of the viewer's page for README.md and docs: python -m bench.viewer_picture [--state viewer hands ...] [--out docs/pictures]

Plays the bundled sequence, with half a second for each picture so that its lights are drawn on a machine that does nothing else, and takes
a screenshot of the page in Chromium, in each of STATES that is asked for, at a moment when it says so.
"""

import argparse
import math
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

from playwright.sync_api import sync_playwright

from bench.live import free_port
from tests.support.browser import BROWSER_OPTIONS, CHROMIUM, SOFTWARE_GL
from vemlight.commands.service_commands import BUNDLED_RENDERER

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
NOTHING_CHOSEN = {**dict.fromkeys(("count", "masks", "lamps", "in_s", "out_s", "speed", "camera")), "poses": [], "paused": False}
SETTLED = '() => ["live", "paused, refined"].includes(document.getElementById("overall").textContent)'
STATE_MS = 4_000  # in which what was chosen is seen
START_MS = 180_000  # GL, and the first time compiled code
FRAME_MS = 500  # target of a picture
SETTLE_MS = 20_000  # in which lights and exposure settle and the counters of the start are past


def as_it_opens(page: Any) -> None:
    """Nothing is chosen."""


def hands(page: Any) -> None:
    """A mask drawn on the sky, and a warm virtual lamp that is selected."""
    box, rim = page.locator("#disc").bounding_box(), 19  # CSS pixels of the compass around the disc

    def place(azimuth_deg: float, elevation_deg: float) -> tuple[float, float]:
        r, phi = (90 - elevation_deg) / 90 * (box["width"] / 2 - rim), math.radians(azimuth_deg)
        return box["x"] + box["width"] / 2 - r * math.cos(phi), box["y"] + box["height"] / 2 - r * math.sin(phi)

    page.locator("[data-tool=polygon]").click()
    corners = [(20.0, 10.0), (60.0, 10.0), (60.0, 55.0), (20.0, 45.0)]
    for corner in [*corners, corners[0]]:
        page.mouse.click(*place(*corner))
    page.locator("[data-tool=lamp]").click()
    page.mouse.move(*place(250.0, 40.0))
    page.mouse.down()
    page.mouse.move(*place(250.0, 34.0))
    page.mouse.up()
    page.locator("#lamp-colour").fill("#ff9a5c")
    page.evaluate("scrollTo(0, 0)")
    page.mouse.move(*place(120.0, 60.0))


def timeline(page: Any) -> None:
    """The timeline, of which a part is played at half the speed, and the graphs."""
    page.locator("#strip").focus()
    for steps, key in ((12, "["), (28, "]")):
        page.keyboard.press("Home")  # the in point
        for _ in range(steps):
            page.keyboard.press("ArrowRight")
        page.keyboard.press(key)
    page.keyboard.press("Space")
    page.locator("#speed").select_option("0.5")
    page.evaluate("document.getElementById('meter').hidden = true")
    page.locator("#timeline").evaluate("(panel) => scrollTo(0, panel.offsetTop - 12)")


def relit(page: Any) -> None:
    """The server's picture to the left of a line, the browser's to the right, from a camera that was turned."""
    page.locator("#relit-camera").wait_for(timeout=START_MS)
    page.locator("[data-relit=split]").click()
    box = page.locator("#picture").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 4, box["y"] + box["height"] / 2)  # beside the line between the two
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 4 - 30, box["y"] + box["height"] / 2 + 10, steps=4)
    page.mouse.up()
    page.locator("#relit[data-shown]").wait_for(timeout=START_MS)
    page.evaluate("scrollTo(0, 0)")
    page.wait_for_timeout(SETTLE_MS)


def meter(page: Any) -> None:
    """The light meter, below the sky and the picture in false colours."""
    page.locator("#false-colour").click()
    page.locator("#meter").scroll_into_view_if_needed()
    page.locator("#meter-table").click()
    page.locator("#scene").evaluate("(panel) => scrollTo(0, panel.offsetTop + 120)")


def handles(page: Any) -> None:
    """The knot on its plinth, selected by a click and moved up, with the handles that turn it."""
    page.locator("[data-gizmo=turn]:enabled").click()
    box = page.locator("#gizmo").bounding_box()
    page.mouse.click(box["x"] + 0.777 * box["width"], box["y"] + 0.33 * box["height"])
    page.locator("#gizmo").focus()
    page.keyboard.press("w")
    for _ in range(2):
        page.keyboard.press("PageUp")
    page.keyboard.press("e")
    page.mouse.move(0, 0)


def pause(page: Any) -> None:
    """A paused picture, refined."""
    page.locator("#pause").click()
    page.locator("#scene-facts", has_text="pass 64 of 64").wait_for(timeout=START_MS)


class State(NamedTuple):
    """What is done with the page, and the window: CSS pixels and theme."""

    act: Callable[[Any], None]
    width: int = 1440
    height: int = 900
    theme: Literal["dark", "light"] = "dark"


STATES = {
    "viewer": State(as_it_opens),
    "hands": State(hands),
    "handles": State(handles, theme="light"),
    "time": State(timeline),
    "relit": State(relit, width=1280, height=800),
    "meter": State(meter, height=1000),
    "refined": State(pause),
    "phone": State(as_it_opens, width=390, height=844),
}


def screenshot(url: str, out: Path, state: State) -> None:
    """The page at `url` as PNG, once it shows pictures."""
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=BROWSER_OPTIONS + SOFTWARE_GL)
        page = browser.new_page(viewport={"width": state.width, "height": state.height}, color_scheme=state.theme)
        page.goto(url)
        page.locator("#picture[data-shown]").wait_for(state="attached", timeout=START_MS)
        page.locator("#guide").get_by_role("button", name="Close").click()  # which the first visit shows
        page.wait_for_timeout(SETTLE_MS)
        state.act(page)
        page.wait_for_timeout(STATE_MS)
        page.wait_for_function(SETTLED, timeout=START_MS)
        page.screenshot(path=out)
        page.request.post(f"{url}/control", data=NOTHING_CHOSEN)
        browser.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--state", choices=STATES, nargs="+", default=["viewer"], help="of one run, one after the other")
    parser.add_argument("--out", type=Path, default=PICTURES, help="folder of the pictures, STATE.png")
    asked, port = parser.parse_args(), free_port()
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "vemlight.toml"
        look = "".join(f"{key} = {value!r}\n" for key, value in BUNDLED_RENDERER.items())
        drawing = f"[renderer]\nframe_ms = {FRAME_MS}\n{look}"
        settings.write_text(f'[wire]\nfolder = "{folder}/sockets"\n{drawing}[viewer]\nport = {port}\n')
        run = subprocess.Popen([sys.executable, "-m", "vemlight", "run", str(settings)], stdout=subprocess.PIPE, text=True)
        try:
            assert run.stdout
            run.stdout.readline()  # its first line: the page can be opened
            for name in asked.state:
                screenshot(f"http://127.0.0.1:{port}", asked.out / f"{name}.png", STATES[name])
        finally:
            run.send_signal(signal.SIGTERM)
            run.wait()


if __name__ == "__main__":
    main()
