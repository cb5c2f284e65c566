"""How many files may be open, and how many peers that leaves."""

import resource

import pytest

from tests.support.hostile_peers.__main__ import cost_of
from vemlight.runtime.instances import MAX_CAMERAS
from vemlight.runtime.open_files import MAX_PEERS, OWN_FILES, file_limit, hard_file_limit, peer_limit, raise_file_limit


def test_the_limit_is_raised_to_the_hard_one():
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (before[1] // 2, before[1]))
        assert raise_file_limit() == hard_file_limit() == file_limit() == before[1]
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.parametrize("files", [16, 64, 256, 1024, 4096, 20_000, 2**20])
def test_peers_leave_room_for_the_service_and_for_those_that_come_meanwhile(files):
    assert 1 <= peer_limit(files) <= MAX_PEERS
    assert peer_limit(files) == 1 or OWN_FILES + 2 * peer_limit(files) <= files
    assert peer_limit(files) == 1 or 45 + 4 * MAX_CAMERAS + 3 * peer_limit(files) <= files, "a rig's viewer, in a crowd"
    assert MAX_PEERS >= 1000  # subscribers that one machine can serve
    assert peer_limit(2**20) == MAX_PEERS


def test_subscribers_beyond_the_files_are_refused_and_the_service_goes_on():
    cost = cost_of("300 subscribers at 256 files", "ipc")
    assert cost.lived
    assert cost.frames > 50  # at an honest subscriber, meanwhile
