"""A run whose services and supervisor are killed and stopped gives the same bytes as one that nobody disturbed."""

import pytest

from tests.support.nemesis import compare


def test_whatever_is_killed_or_stopped_the_output_is_the_same(tmp_path):
    done = compare(tmp_path, frames=24, pictures=6, seed=5)
    assert sum(count for what, count in done.items() if "killed" in what) >= 1, done


@pytest.mark.long
def test_so_it_is_with_a_rig_of_cameras(tmp_path):
    done = compare(tmp_path, frames=24, pictures=6, seed=2, cameras=2)
    assert sum(count for what, count in done.items() if "killed" in what) >= 1, done
