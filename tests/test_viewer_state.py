"""The state counts what it shows and passes over; `/metrics` is text that Prometheus reads."""

import asyncio
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tomli_w
from prometheus_client import Metric, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from vemlight.errors import UserError
from vemlight.light.near_lights import NearLightSet
from vemlight.runtime import stamps, wire
from vemlight.runtime.poses import Pose
from vemlight.runtime.reports import ImageReport, LightsReport, MapReport, PointsReport
from vemlight.runtime.service_stats import ServiceStats
from vemlight.settings import Rig, Settings
from vemlight.viewer import report_fields as report_fields_module
from vemlight.viewer.metrics import registry
from vemlight.viewer.report_fields import report_fields
from vemlight.viewer.viewer_state import ViewerState

UNITS = (
    "_total",
    "_hertz",
    "_lux",
    "_seconds",
    "_frames",
    "_bytes",
    "_fds",
    "_state",
    "_cells",
    "_cameras",
    "_sources",
    "_pixels",
    "_lights",
    "_depth",
    "_budget",
    "_pages",
    "_ratio",
    "_passes",
    "_left_out",
    "_halvings",
)


def metrics(state: ViewerState) -> list[Metric]:
    """What a Prometheus server reads."""
    return list(text_string_to_metric_families(generate_latest(registry(state.summary)).decode()))


def sample(viewer: ViewerState, metric_name: str, **labels: str) -> float:
    """The value of a metric with these labels."""
    (value,) = (s.value for metric in metrics(viewer) for s in metric.samples if s.name == metric_name and s.labels == labels)
    return value


def image(sequence: int) -> wire.Message:
    header = wire.ImageMessage(stamp=stamps.stamp(sequence, 0.0), width=2, height=1, report=ImageReport(drawn_lights=3, render_ms=1))
    return header, (np.zeros((1, 2, 4), np.uint8),)


def status(frames: int) -> wire.Message:
    status = wire.StatusMessage(
        service="renderer", sequence=frames, rate_hz=25, age_ms=30, step_ms=9, frames=frames, skipped=2, dropped=1, refused=0, restarts=4
    )
    return status, ()


def full_state() -> ViewerState:
    state = ViewerState(Settings(), restarts=2)
    state.take("renderer", [status(10), image(10), image(11), image(12)])
    state.take("renderer", [status(15)])  # 5 made, 3 came
    state.status_if_due()
    return state


def test_what_is_passed_over_and_what_is_lost():
    status = full_state().status
    assert status
    assert (status.sequence, status.frames, status.skipped, status.dropped, status.restarts) == (12, 1, 2, 2, 2)


def test_the_summary_has_a_row_for_each_service():
    summary = full_state().summary()
    assert [row["service"] for row in summary["services"]] == ["capture", "sampler", "renderer", "viewer"]
    assert [row["state"] for row in summary["services"]] == ["not seen", "not seen", "live", "live"]
    assert not summary["healthy"]
    assert ViewerState(Settings(), 0).summary()["services"][-1]["text"] == "waiting for renderer"


def test_a_feed_whose_newest_cannot_be_encoded_is_named_until_one_can():
    state, failures = ViewerState(Settings(), 0), []

    async def run() -> None:
        for pixels in (np.zeros((2, 3), np.uint8), np.zeros((2, 3, 4), np.uint8)):  # the first has no colours
            state.picture.put(pixels)
            await state.picture.newest()
            failures.append(state.summary()["failures"])

    asyncio.run(run())
    (named, reason), *others = failures[0].items()
    assert (named, others, failures[1]) == ("picture", [], {})
    assert "error" in reason


def test_a_choice_changes_what_it_names():
    state = ViewerState(Settings(), 0)
    state.set_control(b'{"count": 5, "paused": true}')
    state.set_control(b'{"exposure": 2}')
    state.set_control(b'{"count": null}')
    assert state.control == wire.ControlMessage(exposure=2.0, paused=True)
    with pytest.raises(UserError, match="lossless"):
        ViewerState(Settings(mode="lossless"), 0).set_control(b"{}")


@pytest.mark.parametrize("state", [ViewerState(Settings(), 0), full_state()], ids=["empty", "full"])
def test_metrics_have_one_prefix_base_units_and_few_samples(state):
    found = metrics(state)
    for metric in found:
        name = f"{metric.name}_total" if metric.type == "counter" else metric.name
        assert name.startswith(("vemlight_", "process_"))
        assert name.endswith(UNITS)
        assert metric.documentation
    samples = [(s.name, tuple(s.labels.items())) for metric in found for s in metric.samples]
    assert len(samples) == len(set(samples)) <= 200


@pytest.fixture
def rig_state(tmp_path) -> ViewerState:
    """Of a rig of two cameras, of which one is silent; fuse has published a frame with near lights, and the sampler its lights."""
    cameras = [{"name": name, "source": name, "at": [k, 0, 1]} for k, name in enumerate("ab")]
    (tmp_path / "rig.toml").write_text(tomli_w.dumps({"camera": cameras}))
    state = ViewerState(Settings(rig=Rig(file=str(tmp_path / "rig.toml"))), 0)
    stamp, none = stamps.stamp(8, 0.32), np.zeros((0, 3), np.float32)
    report = PointsReport(cameras=1, silent_cameras=1, near_lights=1, spread_ms=2.0)
    near = NearLightSet.of(np.array([3]), np.array([[0, 0, 2]]), np.array([[4, 4, 4]]), np.zeros(1), np.zeros(1))
    stats = ServiceStats("fuse", 0)
    points = wire.PointsMessage(stamp=stamp, count=1, at=(0.0, 0.0, 1.0), report=report)
    stats.on_finished((points, near.arrays()), 0.004)
    status = stats.status_if_due()
    assert status
    state.take("fuse", [(points, near.arrays()), (status, ())])
    lights = wire.LightsMessage(stamp=stamp, count=0, coverage="sphere")
    state.take("sampler", [(lights, (np.zeros(0, np.int64), none, none, none, none))])
    made = msgspec.structs.replace(status, service="capture.a", report=MapReport(saturated_pixels=7))
    state.take("capture.a", [(made, ())])
    return state


def test_a_rig_s_cameras_have_a_row_each_and_fuse_one(rig_state):
    rows = {row["service"]: row for row in rig_state.summary()["services"]}
    assert list(rows) == ["capture.a", "capture.b", "fuse", "sampler", "renderer", "viewer"]
    assert {row["kind"] for row in rows.values()} == {"capture", "fuse", "sampler", "renderer", "viewer"}
    assert (rows["capture.a"]["state"], rows["capture.b"]["state"], rows["fuse"]["state"]) == ("live", "not seen", "live")
    assert rows["fuse"]["report"]["silent_cameras"] == 1


def test_metrics_of_several_cameras_are_one_family_with_their_names(rig_state):
    assert sample(rig_state, "vemlight_capture_saturated_pixels", name="a") == 7
    assert sample(rig_state, "vemlight_stage_state", stage="capture.a", state="live") == 1
    assert sample(rig_state, "vemlight_fuse_spread_seconds") == pytest.approx(0.002)
    names = [metric.name for metric in metrics(rig_state)]
    assert len(set(names)) == len(names)


def test_near_lights_are_in_the_lights_of_the_page(rig_state):
    _, line = asyncio.run(rig_state.lights.newest())
    row = msgspec.json.decode(line)
    assert (row["schema"], row["at"], row["points"][0]["id"]) == ("vemlight.lights/2", [0.0, 0.0, 1.0], 3)
    (near,) = rig_state.summary()["near_lights"]
    assert (near["id"], near["distance_m"]) == (3, 1.0)
    assert near["at"] == row["points"][0]["at"]
    _, placed = asyncio.run(rig_state.placed_lights.newest())
    assert np.frombuffer(placed[24:48]).tolist() == [0.0, 0.0, 1.0], "docs/clients.md"
    assert np.frombuffer(placed[56:64])[0] == 3
    assert np.frombuffer(placed[64:], np.float32).tolist() == [0, 0, 2, 4, 4, 4, 0]


@pytest.mark.parametrize(
    "choice", [b'"masks": [{"points": [[0, 0], [10, 0], [0, 10]]}]', b'"source": "bundled"', b'"record": true', b'"speed": 2']
)
def test_what_is_of_one_camera_is_refused_where_several_are_fused(rig_state, choice):
    with pytest.raises(UserError, match="is for one camera, and here those of a rig are fused; leave it out"):
        rig_state.set_control(b"{" + choice + b"}")
    assert rig_state.control == wire.ControlMessage()
    rig_state.set_control(b'{"paused": true, "exposure": 1}')


def test_the_page_shows_every_unit_of_a_report():
    page = (Path(__file__).parents[1] / "services" / "viewer" / "page" / "viewer.js").read_text()
    shown = re.search(r"const FORMATS = \{ (.*?) \};", page)
    assert shown
    assert {word.partition(":")[0].strip('"') for word in shown[1].split(", ")} == {"", *report_fields_module.UNITS.values()}


def test_every_field_of_a_report_is_a_metric_in_base_units_and_a_row_of_the_page():
    state, stamp, none = ViewerState(Settings(), 0), stamps.stamp(8, 0.32), np.zeros((0, 3), np.float32)
    stats = ServiceStats("sampler", 0)
    report = LightsReport(delay_ms=160.0, delay_frames=4.0, required_lights=90, lamp_hz=100.0)
    lights = wire.LightsMessage(stamp=stamp, count=0, coverage="hemisphere", report=report)
    stats.on_finished((lights, (np.zeros(0, np.int64), none, none, none, none)), 0.003)
    status = stats.status_if_due()
    assert status
    state.take("sampler", [(status, ())])
    assert sample(state, "vemlight_sampler_delay_seconds") == 0.16
    assert sample(state, "vemlight_sampler_delay_frames") == 4
    assert sample(state, "vemlight_sampler_required_lights") == 90
    assert sample(state, "vemlight_sampler_lamp_hertz") == 100

    summary = state.summary()
    assert summary["services"][1]["report"] == msgspec.structs.asdict(report)
    assert [field["name"] for field in summary["report_fields"]["sampler"]] == list(LightsReport.__struct_fields__)
    delay = summary["report_fields"]["sampler"][0]
    assert (delay["label"], delay["unit"], delay["is_loss"]) == ("filter delay", "ms", False)
    assert [field["name"] for field in summary["report_fields"]["capture"] if field["is_loss"]] == ["invalid_cells", "saturated_pixels"]
    assert all(field["meaning"] for fields in summary["report_fields"].values() for field in fields)


def test_a_service_that_reports_nothing_has_no_fields():
    assert report_fields("plate") == ()


def test_metrics_repeat_what_the_services_published():
    state = full_state()
    assert sample(state, "vemlight_frames_total", stage="renderer", outcome="done") == 15
    assert sample(state, "vemlight_frames_total", stage="viewer", outcome="dropped") == 2
    assert sample(state, "vemlight_stage_state", stage="capture", state="not seen") == 1
    assert sample(state, "vemlight_frame_age_seconds", stage="renderer") == pytest.approx(0.03)


def test_durations_are_a_histogram_of_the_time_for_a_frame():
    state, stats = ViewerState(Settings(), 0), ServiceStats("renderer", 0)
    for step_s in (0.0005, 0.001, 0.0011, 0.3, 7.0):
        stats.on_finished(image(0), step_s)
    status = stats.status_if_due()
    assert status
    state.take("renderer", [(status, ())])
    counts = {
        bound: sample(state, "vemlight_stage_duration_seconds_bucket", stage="renderer", le=bound)
        for bound in ("0.001", "0.002", "5.0", "+Inf")
    }
    assert counts == {"0.001": 2, "0.002": 3, "5.0": 4, "+Inf": 5}
    assert sample(state, "vemlight_stage_duration_seconds_count", stage="renderer") == 5
    assert sample(state, "vemlight_stage_duration_seconds_sum", stage="renderer") == pytest.approx(7.3026)


def test_a_pose_is_chosen_and_withdrawn() -> None:
    state = ViewerState(Settings(), 0)
    state.set_control(b'{"poses": [{"name": "box", "position": [0, 0, 1]}], "count": 5}')
    assert state.control.poses == (Pose(name="box", position=(0.0, 0.0, 1.0)),)
    state.set_control(b'{"exposure": 1.0}')
    assert len(state.control.poses) == 1
    state.set_control(b'{"poses": null, "count": null}')
    assert state.control == wire.ControlMessage(exposure=1.0)


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
        ViewerState(Settings(), 0).set_control(f'{{"poses": {poses}}}'.encode())
    assert "\n" not in str(caught.value)
