"""The table of channels and the kinds of messages belong together."""

from collections import Counter

import pytest

from vemlight.runtime import wire
from vemlight.runtime.channels import BACKPRESSURE_FROM, CHANNELS, FRAMES, LAST, SERVICES, STATUS, UPSTREAM


def test_each_kind_of_message_but_requests_has_a_channel():
    assert Counter(channel.kind for channel in CHANNELS) == Counter(wire.KINDS.keys() - {"request"})


def test_a_service_publishes_one_kind_of_frame_but_fuse_which_publishes_points_beside_its_map():
    frames = {kind for kind, header in wire.KINDS.items() if issubclass(header, wire.FrameHeader)}
    published = Counter(producer for channel in CHANNELS if channel.kind in frames for producer in channel.producers)
    assert {service for service, kinds in published.items() if kinds > 1} == {"fuse"}
    assert {channel.kind for channel in FRAMES.values()} == frames
    assert FRAMES["fuse"].kind == "points"


def test_frames_go_from_capture_to_the_last_service():
    way, service = [], LAST
    while service:
        way.append(service)
        service = UPSTREAM[service]
    assert way == ["renderer", "sampler", "capture"]
    assert set(UPSTREAM) | set(BACKPRESSURE_FROM) | {"viewer"} == set(SERVICES)


@pytest.mark.parametrize(("fps", "timeout_s"), [(25.0, 0.12), (0.5, 6.0)])
def test_a_stall_is_three_missing_frames_and_silence_three_missing_statuses(fps, timeout_s):
    assert FRAMES["sampler"].timeout_s(fps) == pytest.approx(timeout_s)
    assert STATUS.timeout_s(fps) == pytest.approx(1.5)
