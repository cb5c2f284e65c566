import numpy as np

from bench.relaxed_points import relaxed_halton
from vemlight.sampler.warps.points import RELAXED, points


def test_the_stored_table_is_what_the_relaxation_makes():
    made = relaxed_halton(RELAXED)
    np.testing.assert_allclose(points(RELAXED, "relaxed"), made, atol=1e-6)
