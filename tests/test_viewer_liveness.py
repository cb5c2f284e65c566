"""Judgements on made-up times, and losses counted against what was really lost."""

import random

import msgspec

from vemlight.compiling import COMPILING, compiling_file
from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import Service
from vemlight.runtime.restarts import restarting_file, say_restarting
from vemlight.runtime.service_stats import LossCounter
from vemlight.runtime.session import SESSION
from vemlight.viewer.liveness import HEALTHY, Liveness

SILENT_S = 1.5  # three statuses in a row are missing
STAMP = stamps.stamp(5, 0.2)
MAKERS: dict[str, tuple[str, ...]] = {"capture": (), "sampler": ("capture",), "renderer": ("sampler",)}
FRAMES: dict[Service, wire.Header] = {
    "capture": wire.MapMessage(stamp=STAMP, rows=1, cols=1, coverage="hemisphere"),
    "sampler": wire.LightsMessage(stamp=STAMP, count=0, coverage="hemisphere"),
    "renderer": wire.ImageMessage(stamp=STAMP, width=1, height=1),
}


def status(service: Service, frames: int = 1, step_ms: float = 4.0) -> wire.StatusMessage:
    return wire.StatusMessage(
        service=service, sequence=5, rate_hz=25, age_ms=1, step_ms=step_ms, frames=frames, skipped=0, dropped=0, refused=0, restarts=0
    )


def received_all(now_s: float) -> Liveness:
    liveness = Liveness(MAKERS, fps=25)
    for service, frame in FRAMES.items():
        liveness.last_received[service].take(frame, now_s)
        liveness.last_received[service].take(status(service), now_s)
    return liveness


def states(liveness: Liveness, now_s: float) -> list[str]:
    return [judgement.state for judgement in liveness.judge(now_s).values()]


def test_from_not_seen_to_live():
    liveness = Liveness(MAKERS, fps=25)
    assert states(liveness, 0) == ["not seen"] * 3
    liveness.last_received["capture"].take(status("capture"), 10)
    assert states(liveness, 10) == ["starting", "not seen", "not seen"]
    assert states(received_all(10), 10.9) == ["live"] * 3


def test_a_service_that_stalls_is_distinguished_from_those_that_wait_for_it():
    liveness = received_all(10)
    late_s = 11.1  # shown within a second, and not much earlier
    liveness.last_received["capture"].take(FRAMES["capture"], late_s)
    for service in ("sampler", "renderer"):
        liveness.last_received[service].take(status(service), late_s)
    assert states(liveness, late_s) == ["live", "stalled", "waiting"]
    assert liveness.judge(late_s)["renderer"].text == "waiting for sampler"


def test_silence_is_longer_than_a_stall():
    liveness = received_all(10)
    assert states(liveness, 10 + SILENT_S - 0.01) == ["stalled", "waiting", "waiting"]
    assert states(liveness, 10 + SILENT_S + 0.01) == ["silent"] * 3
    assert liveness.judge(10 + 200)["capture"].text == "silent for 3 min"


def test_a_slow_source_and_a_slow_step_are_no_stall():
    slow = Liveness(MAKERS, fps=0.5)
    slow.last_received["capture"].take(FRAMES["capture"], 10)
    slow.last_received["capture"].take(status("capture"), 16)
    assert slow.judge(15.9)["capture"].state == "live"  # two frames missing at most
    assert slow.judge(16.1)["capture"].state == "stalled"
    liveness = received_all(10)
    liveness.last_received["renderer"].take(status("renderer", step_ms=2000), 10)
    assert liveness.judge(15.9)["renderer"].state == "live"  # three times what a frame took
    assert liveness.judge(16.1)["renderer"].state == "silent"
    liveness = received_all(10)
    liveness.last_received["renderer"].take(FRAMES["renderer"], 14)  # the interval of its last two frames counts, too
    assert liveness.judge(20)["renderer"].state == "live"
    assert liveness.judge(27)["renderer"].state == "silent"


def test_a_renderer_that_opens_a_scene_is_not_called_silent_nor_live():
    liveness = received_all(10)
    liveness.on_scene_asked(10)
    assert states(liveness, 11.2)[2] == "starting"
    assert liveness.judge(40)["renderer"].text == "opens the scene, 30 s so far"
    assert liveness.judge(40)["capture"].state == "silent"
    assert liveness.judge(10 + 200)["renderer"].state == "silent"  # it does not come back
    liveness.last_received["renderer"].take(FRAMES["renderer"], 11.0)  # of the scene before
    assert liveness.judge(13)["renderer"].state == "starting"
    liveness.last_received["renderer"].take(FRAMES["renderer"], 20.0)
    assert liveness.judge(20.5)["renderer"].state == "live"
    assert liveness.judge(60)["renderer"].state == "silent"  # opened, and then died


def test_who_compiles_for_what_was_chosen_is_not_called_silent(tmp_path, monkeypatch):
    monkeypatch.setenv(COMPILING, str(tmp_path / "viewer.compiling"))
    compiling_file(tmp_path, "capture").write_text("capture.masking.fill")
    liveness = received_all(10)
    assert states(liveness, 10.9) == ["live"] * 3
    assert liveness.judge(14)["capture"] == ("starting", "compiling capture.masking.fill")
    assert states(liveness, 14)[1:] == ["silent"] * 2
    compiling_file(tmp_path, "capture").unlink()
    assert states(liveness, 14)[0] == "silent"


def test_who_is_started_again_is_called_restarting_at_once_until_it_works(tmp_path, monkeypatch):
    monkeypatch.setenv(SESSION, str(tmp_path / "session"))
    liveness = received_all(10)
    say_restarting(restarting_file(tmp_path, "renderer"), -9)
    assert liveness.judge(10.2)["renderer"] == ("starting", "restarting: it was killed by SIGKILL")
    assert liveness.judge(14)["renderer"].state == "starting"
    assert liveness.judge(14)["sampler"].state == "silent"  # which nobody starts again
    say_restarting(restarting_file(tmp_path, "renderer"), None)
    liveness.last_received["renderer"].take(msgspec.structs.replace(status("renderer"), sequence=None), 14)
    liveness.last_received["sampler"].take(FRAMES["sampler"], 14)
    assert liveness.judge(14.1)["renderer"] == ("starting", "no frame yet")
    liveness.last_received["renderer"].take(FRAMES["renderer"], 14.2)
    assert liveness.judge(14.3)["renderer"].state == "live"


def test_in_lossless_mode_nobody_stalls_who_is_not_asked():
    liveness = Liveness(MAKERS, fps=25, lossless=True)
    liveness.last_received["capture"].take(FRAMES["capture"], 10)
    liveness.last_received["capture"].take(status("capture"), 99)
    assert liveness.judge(100)["capture"].state == "live"
    assert liveness.judge(99 + 1.1 * SILENT_S)["capture"].state == "silent"


def test_the_end_outlasts_silence_until_frames_come_again():
    liveness = received_all(10)
    for last in liveness.last_received.values():
        last.take(wire.EndMessage(sequence=6), 10)
    assert states(liveness, 1000) == ["finished"] * 3
    liveness.last_received["capture"].take(FRAMES["capture"], 1000)
    assert states(liveness, 1000)[0] == "live"


def test_losses_are_what_was_published_and_never_came():
    rng = random.Random(3)
    losses, lost = LossCounter(), 0
    losses.on_status(frames=40)  # the viewer began to listen after 40 frames
    for restart in range(3):
        made = 40 if restart == 0 else 0
        for _ in range(rng.randrange(200, 400)):
            made += 1
            if rng.random() < 0.2:
                lost += 1
            else:
                losses.on_frame()
            if rng.random() < 0.1:
                losses.on_status(made)
                assert losses.dropped == lost
        losses.on_status(made)
        assert losses.dropped == lost
        losses.on_status(0)  # it was started again


def test_a_stage_is_stalled_after_a_second_and_a_finished_one_is_healthy():
    liveness = received_all(10)
    liveness.last_received["capture"].take(FRAMES["capture"], 10.98)
    liveness.last_received["capture"].take(status("capture"), 10.9)
    liveness.last_received["sampler"].take(status("sampler"), 10.9)
    liveness.last_received["renderer"].take(status("renderer"), 10.9)
    assert states(liveness, 10.98) == ["live"] * 3
    assert states(liveness, 11.02) == ["live", "stalled", "waiting"]
    for service in MAKERS:
        liveness.last_received[service].take(wire.EndMessage(sequence=9), 12)
    assert all(state in HEALTHY for state in states(liveness, 100))
