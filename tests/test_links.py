"""Services on two hosts, as two network namespaces with a link that is cut, loses packets or is long."""

import numpy as np
import pytest

from tests.support.linked_listener import LinkedListener
from tests.support.packet_link import HERE, PacketLink, possible
from vemlight.runtime.transport import make_keys

pytestmark = pytest.mark.skipif(not possible(), reason="network namespaces and TUN devices take root and iproute2")


@pytest.fixture
def captured(make_settings, tmp_path):
    """Settings of a capture that publishes to another host with keys, and the process that is one."""
    make_keys(tmp_path / "keys")
    wire = {"transport": "tcp", "keys": str(tmp_path / "keys"), "hosts": {"capture": HERE}}
    settings, path = make_settings(wire=wire, capture={"rows": 16, "cols": 64})
    return settings.wire, ("vemlight.capture", str(path))


def test_after_a_cut_the_newest_frame_is_there_within_a_second(captured):
    """Of 5 s, after which the subscriber has given the connection up and connects anew. Twice: the machine may be busy for a moment."""
    wire, capture = captured
    with PacketLink() as link, LinkedListener(link, capture, wire, "capture", "map") as listener:
        healed_s = [listener.healed_s(5.0) for _ in range(2)]
    assert min(healed_s) < 1.0


def test_over_a_long_link_that_loses_packets_frames_are_young(captured):
    """Its delay is 0.2 s each way, and a packet in a hundred is lost, which takes as long again to be known."""
    wire, capture = captured
    with PacketLink(delay_s=0.2, loss=0.01) as link, LinkedListener(link, capture, wire, "capture", "map") as listener:
        ages_ms = listener.ages_ms(6.0)
    assert len(ages_ms) > 60  # of 150
    assert 200 <= np.median(ages_ms) < 1000
    assert max(ages_ms) < 4000
