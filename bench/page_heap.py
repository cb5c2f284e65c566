"""The page over time: python -m bench.page_heap [--minutes 10]

Simulated services at 25 frames a second, the page in Chromium with false colours and the light meter in sight. Printed each minute: the
page's heap after a collection, elements of the document, pictures shown. Status 1 where the heap has grown by more than 10 MB.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

from tests.support.browser import BROWSER_OPTIONS, CHROMIUM
from tests.support.viewer_process import SimulatedServices, ViewerProcess
from vemlight.settings import Wire

MOST_BYTES = 10 * 2**20
MINUTE_MS = 60_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, default=10)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, sync_playwright() as started:
        folder = Path(name)
        simulated, viewer = SimulatedServices(Wire(folder=str(folder))), ViewerProcess(folder)
        simulated.start()
        viewer.first_line()
        browser = started.chromium.launch(executable_path=CHROMIUM, args=BROWSER_OPTIONS)
        try:
            page = browser.new_page(viewport={"width": 1440, "height": 900})
            page.goto(viewer.url)
            page.locator("#overall[data-state=live]").wait_for()
            page.locator("#guide-close").click()
            page.locator("#false-colour").click()
            page.locator("#graphs").evaluate("(panel) => (panel.open = true)")
            page.locator("#meter").scroll_into_view_if_needed()
            session, heaps = page.context.new_cdp_session(page), []
            for minute in range(asked.minutes + 1):
                session.send("HeapProfiler.collectGarbage")
                heaps.append(page.evaluate("performance.memory.usedJSHeapSize"))
                elements, shown = page.evaluate("[document.querySelectorAll('*').length, document.getElementById('picture').dataset.shown]")
                print(f"{minute} min: heap {heaps[-1] / 1e6:.1f} MB, {elements} elements, {shown} pictures", flush=True)
                if minute < asked.minutes:
                    page.wait_for_timeout(MINUTE_MS)
        finally:
            browser.close()
            viewer.end()
            simulated.end()
    sys.exit(heaps[-1] - heaps[0] > MOST_BYTES)


if __name__ == "__main__":
    main()
