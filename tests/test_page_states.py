"""What the page's pills say: live is only what is not late, whatever the states of the services."""

from itertools import product

import pytest

from tests.support.browser import CHROMIUM
from vemlight.viewer.liveness import STATES
from vemlight.viewer.web import PAGE

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")
ADDRESS = "http://states.test/"
AGES_MS = (None, 40.0, 1990.0, 2010.0, 34_200.0, 4e5, 1e7)
ASK = """async (summaries) => {
    const { overallState, rowState } = await import("/overall_state.js");
    return summaries.map((summary) => [overallState(summary), summary.services.map((row) => rowState(row, summary))]);
}"""


@pytest.fixture(scope="module")
def states_of(browser):
    """Of summaries the pill of each and those of its services: [state, words]."""
    page = browser.new_page()

    def answer(route) -> None:
        name = route.request.url.removeprefix(ADDRESS)
        script = name.endswith(".js")
        body = (PAGE / name).read_text() if script else "<!doctype html>"
        route.fulfill(content_type="text/javascript" if script else "text/html", body=body)

    page.route(f"{ADDRESS}**", answer)
    page.goto(ADDRESS)
    yield lambda summaries: page.evaluate(ASK, summaries)
    page.close()


def summary(capture: str, renderer: str, age_ms: float | None, paused: bool = False, mode: str = "live", measuring: str = "idle") -> dict:
    rows = [("capture", capture, 30.0), ("sampler", "live", age_ms), ("renderer", renderer, age_ms), ("viewer", "live", 30.0)]
    services = [{"service": name, "kind": name, "state": state, "text": state, "age_ms": age} for name, state, age in rows]
    return {"services": services, "control": {"paused": paused}, "mode": mode, "measuring": {"state": measuring}}


def test_what_is_late_is_never_called_live(states_of):
    asked = list(product(STATES, STATES, AGES_MS, (False, True), ("live", "lossless"), ("idle", "running")))
    for case, (pill, rows) in zip(asked, states_of([summary(*each) for each in asked]), strict=True):
        capture, renderer, age_ms, paused, mode, measuring = case
        assert (pill[0] == "live") == (pill[1] in ("live", "lossless")), case
        assert pill[0] != "live" or {capture, renderer} == {"live"}, case
        known = paused or mode == "lossless" or measuring == "running"
        late = age_ms is not None and age_ms >= 2000 and not known
        assert not (late and pill[0] == "live"), case
        assert (rows[2][0] == "behind") == (late and renderer == "live"), case
        assert (rows[1][0] == "behind") == late, case
        rests = measuring == "running" and capture in ("silent", "stalled")
        assert rows[0] == (["paused", "rests while this machine is measured"] if rests else [capture, capture]), "it is in time"
        if measuring == "running":
            assert pill == ["paused", "measuring this machine"] or {"not seen", "starting"} & {capture, renderer}, case
        for state, words in (pill, *rows):
            assert ("behind" in words) == (state == "behind"), case
            assert "live" not in words or state == "live", case


@pytest.mark.parametrize(
    ("age_ms", "words"), [(2100.0, "2 s behind"), (34_200.0, "34 s behind"), (4e5, "7 min behind"), (1e7, "3 h behind")]
)
def test_the_pill_says_how_late(states_of, age_ms, words):
    ((pill, rows),) = states_of([summary("live", "live", age_ms)])
    assert pill == ["behind", words] == rows[2]


def test_what_is_behind_has_the_colour_of_what_is_late(browser):
    page = browser.new_page()
    page.set_content(
        f"<style>{(PAGE / 'viewer.css').read_text()}</style>"
        + "".join(f'<p data-state="{each}">' for each in ("behind", "stalled", "live"))
    )
    behind, stalled, live = page.evaluate("[...document.querySelectorAll('p')].map((p) => getComputedStyle(p).getPropertyValue('--tone'))")
    assert behind == stalled != live
    page.close()
