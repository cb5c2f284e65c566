"""The browser of the tests of pages."""

import json
import shutil
from typing import Any

import pytest

from tests.support.viewer_process import PATIENCE_S

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
BROWSER_OPTIONS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
]  # fmt: skip
SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # WebGL where there is no GPU, as where tests run
# CSS pixels across and down of the windows that pages are tested in: a screen, a small one, a phone.
SIZES = {"desk": (1440, 900), "small": (800, 600), "phone": (390, 844)}
WINDOWS = ("desk", *(pytest.param(size, marks=pytest.mark.long) for size in ("small", "phone")))


def new_page(browser: Any, size: str, **options: Any) -> Any:
    """A page of one of SIZES; it waits as long as tests do. complaints: what it has logged, and its errors."""
    width, height = SIZES[size]
    page = browser.new_page(viewport={"width": width, "height": height}, has_touch=size == "phone", **options)
    page.set_default_timeout(PATIENCE_S * 1e3)
    page.complaints = []
    page.on("console", lambda message: page.complaints.append(message.text))
    page.on("pageerror", lambda error: page.complaints.append(str(error)))
    return page


def with_summary(route: Any, more: dict) -> None:
    """For `route_web_socket`: messages of the viewer, with other values in its summaries, as they are when each is sent."""
    server = route.connect_to_server()

    def onwards(message: str | bytes) -> None:
        if isinstance(message, str) and message.startswith("{") and "why_no_controls" in message:
            message = json.dumps({**json.loads(message), **more})
        route.send(message)

    server.on_message(onwards)
