"""The picture of the viewer's page in README.md: python -m bench.viewer_picture [--out docs/pictures/viewer.png]

Plays the bundled sequence, with half a second for each picture so that all its lights are drawn on any machine, and takes a screenshot of
the page in Chromium, 1280 x 800.
"""

import argparse
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from bench.live import free_port
from tests.support.browser import BROWSER_OPTIONS, CHROMIUM
from vemlight.commands.service_commands import BUNDLED_RENDERER

WIDTH, HEIGHT = 1280, 800  # pixels
START_MS = 180_000  # GL, and the first time compiled code
FRAME_MS = 500  # target of a picture
SETTLE_MS = 25_000  # in which lights and exposure settle and the counters of the start are past


def screenshot(url: str, out: Path) -> None:
    """The page at `url` as PNG, once it shows pictures."""
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=BROWSER_OPTIONS)
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        page.goto(url)
        page.locator("#picture[data-shown]").wait_for(state="attached", timeout=START_MS)
        page.wait_for_timeout(SETTLE_MS)
        page.screenshot(path=out)
        browser.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "pictures" / "viewer.png")
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
            screenshot(f"http://127.0.0.1:{port}", asked.out)
        finally:
            run.send_signal(signal.SIGTERM)
            run.wait()


if __name__ == "__main__":
    main()
