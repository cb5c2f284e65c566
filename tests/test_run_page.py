"""`vemlight run` seen in a real browser: frames arrive, the slider changes what the sampler sends, a killed renderer shows."""

import os
import re
import signal

import pytest

from tests.support.browser import CHROMIUM
from tests.support.processes import LOADED_S, MessageListener, children
from vemlight.runtime import wire

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")


def test_the_page_of_a_run(run, browser):
    settings, process = run(renderer={"frame_ms": 0})  # as many lights as are wished, however busy the machine
    listener = MessageListener(settings, "lights", "image")
    page = browser.new_page()
    page.set_default_timeout(LOADED_S * 1e3)
    try:
        listener.next(wire.ImageMessage)
        page.goto(f"http://127.0.0.1:{settings.viewer.port}")
        page.locator("#picture[data-shown]").wait_for(state="attached")
        page.locator("#disc[data-shown]").wait_for(state="attached")
        listener.next(wire.LightsMessage, lambda lights: lights.count == 16)

        page.locator("#count-number").fill("33")
        page.locator("#count-number").press("Enter")
        listener.next(wire.LightsMessage, lambda lights: lights.count == 33)
        listener.next(wire.ImageMessage, lambda image: image.report.drawn_lights == 33)

        renderer = children(process.pid)["renderer"]
        os.kill(renderer, signal.SIGSTOP)
        card = page.locator("article", has_text="renderer")
        card.get_by_text(re.compile("silent|stalled|no frame")).first.wait_for()
        os.kill(renderer, signal.SIGKILL)
        page.wait_for_function(
            """() => [...document.querySelectorAll("article")].some(card => card.querySelector("h3").textContent === "renderer"
                && /restarts\\s*1/.test(card.textContent.replace(/\\s+/g, " ")) && /live/.test(card.textContent))"""
        )
        listener.next(wire.ImageMessage, lambda image: image.report.drawn_lights == 33)  # the choice outlives the renderer
    finally:
        page.close()
        listener.close()
        process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=10) == 0
