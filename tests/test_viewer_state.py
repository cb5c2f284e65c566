"""The state counts what it shows and passes over; `/metrics` is text that Prometheus reads."""

import re

import numpy as np
import pytest

from vemlight.errors import UserError
from vemlight.runtime import wire
from vemlight.runtime.service_stats import ServiceStats
from vemlight.settings import Settings
from vemlight.viewer.metrics import metrics
from vemlight.viewer.viewer_state import ViewerState

SAMPLE = re.compile(r'([a-z_]+)(?:\{((?:[a-z]+="[^"\\]*",?)*)\})? ([-+0-9.e]+)')
UNITS = ("_total", "_hertz", "_seconds", "_frames", "_bytes", "_fds", "_state", "_cells", "_lights", "_pages")


def image(sequence: int) -> wire.Message:
    header = wire.ImageMessage(stamp=wire.stamp(sequence, 0.0), width=2, height=1, report=wire.ImageReport(drawn_lights=3, render_ms=1))
    return header, (np.zeros((1, 2, 4), np.uint8),)


def status(frames: int) -> wire.Message:
    said = wire.StatusMessage(
        service="renderer", sequence=frames, rate_hz=25, age_ms=30, step_ms=9, frames=frames, skipped=2, dropped=1, refused=0, restarts=4
    )
    return said, ()


def full_state() -> ViewerState:
    state = ViewerState(Settings(), restarts=2)
    state.take("renderer", [status(10), image(10), image(11), image(12)])
    state.take("renderer", [status(15)])  # 5 made, 3 came
    state.status_due()
    return state


def test_what_is_passed_over_and_what_is_lost():
    said = full_state().status
    assert said
    assert (said.sequence, said.frames, said.skipped, said.dropped, said.restarts) == (12, 1, 2, 2, 2)


def test_the_summary_has_a_row_for_each_service():
    summary = full_state().summary()
    assert [row["service"] for row in summary["services"]] == ["capture", "sampler", "renderer", "viewer"]
    assert [row["state"] for row in summary["services"]] == ["not heard", "not heard", "live", "live"]
    assert not summary["healthy"]
    assert ViewerState(Settings(), 0).summary()["services"][-1]["words"] == "waits for renderer"


def test_a_wish_changes_what_it_names():
    state = ViewerState(Settings(), 0)
    state.wish_for(b'{"count": 5, "paused": true}')
    state.wish_for(b'{"exposure": 2}')
    state.wish_for(b'{"count": null}')
    assert state.wish == wire.ControlMessage(exposure=2.0, paused=True)
    with pytest.raises(UserError, match="lossless"):
        ViewerState(Settings(mode="lossless"), 0).wish_for(b"{}")


@pytest.mark.parametrize("state", [ViewerState(Settings(), 0), full_state()], ids=["empty", "full"])
def test_metrics_keep_to_the_form(state):
    kinds: dict[str, str] = {}
    seen = set()
    for line in metrics(state.summary()).splitlines():
        if line.startswith("# TYPE "):
            _, _, name, kind = line.split()
            assert kinds.setdefault(name, kind) is kind
            assert name.startswith(("vemlight_", "process_"))
            assert name.endswith(UNITS)
            assert name.endswith("_total") == (kind == "counter")
        elif not line.startswith("# HELP "):
            parts = SAMPLE.fullmatch(line)
            assert parts, line
            assert parts[1] in kinds
            assert line.rsplit(" ", 1)[0] not in seen
            seen.add(line.rsplit(" ", 1)[0])
            float(parts[3])
    assert len(seen) <= 200


def test_the_filters_delay_is_told_in_seconds_and_in_frames():
    state, stamp, none = ViewerState(Settings(), 0), wire.stamp(8, 0.32), np.zeros((0, 3), np.float32)
    stats = ServiceStats("sampler", 0)
    lights = wire.LightsMessage(stamp=stamp, count=0, coverage="hemisphere", report=wire.LightsReport(delay_ms=160.0, delay_frames=4.0))
    stats.finished((lights, (np.zeros(0, np.int64), none, none, none, none)), 0.001)
    said = stats.due()
    assert said
    state.take("sampler", [(said, ())])
    text = metrics(state.summary()).splitlines()
    assert 'vemlight_filter_delay_seconds{stage="sampler"} 0.16' in text
    assert 'vemlight_filter_delay_frames{stage="sampler"} 4' in text


def test_metrics_say_what_the_services_said():
    text = metrics(full_state().summary())
    assert 'vemlight_frames_total{stage="renderer",outcome="done"} 15\n' in text
    assert 'vemlight_frames_total{stage="viewer",outcome="dropped"} 2\n' in text
    assert 'vemlight_stage_duration_seconds{stage="renderer",quantile="0.5"} 0.009\n' in text
    assert 'vemlight_stage_state{stage="capture",state="not heard"} 1\n' in text


def test_a_pose_is_wished_and_taken_back() -> None:
    state = ViewerState(Settings(), 0)
    state.wish_for(b'{"poses": [{"name": "box", "position": [0, 0, 1]}], "count": 5}')
    assert state.wish.poses == (wire.Pose(name="box", position=(0.0, 0.0, 1.0)),)
    state.wish_for(b'{"exposure": 1.0}')
    assert len(state.wish.poses) == 1
    state.wish_for(b'{"poses": null, "count": null}')
    assert state.wish == wire.ControlMessage(exposure=1.0)


@pytest.mark.parametrize(
    "poses",
    [
        '[{"name": "box", "position": [0, 0, 1e9]}]',
        '[{"name": "box", "position": [0, 0, 1], "rotation": [0, 0, 0, 2]}]',
        "7",
        '[{"name": "box"}]',
        "[" * 99,
    ],
)
def test_poses_that_nothing_can_take_are_one_line(poses: str) -> None:
    with pytest.raises(UserError, match=r"^control: ") as caught:
        ViewerState(Settings(), 0).wish_for(f'{{"poses": {poses}}}'.encode())
    assert "\n" not in str(caught.value)
