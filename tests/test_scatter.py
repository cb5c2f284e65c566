"""Fisheye images through their weights."""

import itertools
from typing import get_args

import msgspec
import numpy as np
import pytest

from vemlight.capture.fisheye import MAP_PARTS, BayerPattern, colour_lattices, fisheye_to_polar, lit_runs, lit_spans
from vemlight.capture.lens import Lens
from vemlight.capture.scatter import Threads, clipped_counts, polar_from_codes, polar_from_fisheye
from vemlight.light.sphere import map_irradiance
from vemlight.settings import Capture

LENS = Lens(size=(220, 200), f=(57.0, 57.5), c=(109.2, 99.6), k1=-0.01, k2=0.001, k3=0.0, k4=0.0, rim_deg=95.0)
WEIGHTS = fisheye_to_polar(LENS, 45, 180, "hemisphere")


@pytest.mark.parametrize("count", [2, 3, MAP_PARTS, MAP_PARTS + 1])
def test_any_number_of_threads_gives_the_same_bytes(count: int) -> None:
    rng, threads = np.random.default_rng(1), Threads(count)
    codes, table = rng.integers(0, 4096, (200, 220)).astype(np.uint16), rng.lognormal(0, 3, 65536).astype(np.float32)
    image = rng.lognormal(0, 3, (200, 220, 3)).astype(np.float32)
    assert polar_from_codes(codes, WEIGHTS, table, threads).tobytes() == polar_from_codes(codes, WEIGHTS, table).tobytes()
    assert polar_from_fisheye(image, WEIGHTS, threads).tobytes() == polar_from_fisheye(image, WEIGHTS).tobytes()


def test_an_error_in_another_thread_is_raised() -> None:
    def job(some: slice) -> None:
        if some.start > 0:
            raise MemoryError("no room")

    with pytest.raises(MemoryError):
        Threads(2).run(job, WEIGHTS.ends)


@pytest.mark.parametrize("lattices", [None, *colour_lattices("GRBG")])
def test_parts_have_cells_of_their_own_and_much_the_same_work(lattices: tuple | None) -> None:
    weights = fisheye_to_polar(LENS, 45, 180, "hemisphere", lattices) if lattices else WEIGHTS
    assert weights.ends[0] == 0
    assert weights.ends[-1] == len(weights.cell)
    cells = [np.unique(weights.cell[begin:end]) for begin, end in itertools.pairwise(weights.ends)]
    assert all(before.max() < after.min() for before, after in itertools.pairwise(cells))
    assert np.diff(weights.ends).max() < 1.1 * len(weights.cell) / MAP_PARTS


def test_codes_are_radiance_by_the_table() -> None:
    rng = np.random.default_rng(2)
    codes, table = rng.integers(0, 256, (200, 220)).astype(np.uint8), rng.lognormal(0, 1, 256).astype(np.float32)
    by_codes = polar_from_codes(codes, WEIGHTS, table)
    by_radiance = polar_from_fisheye(np.repeat(table[codes][..., None], 3, -1), WEIGHTS)
    assert by_codes.tobytes() == by_radiance[..., 1].tobytes()


def test_a_black_frame_is_a_black_map() -> None:
    assert not polar_from_codes(np.zeros((200, 220), np.uint16), WEIGHTS, np.zeros(65536, np.float32)).any()


def test_a_map_too_small_for_all_parts_is_whole() -> None:
    weights = fisheye_to_polar(LENS, 2, 4, "hemisphere")  # one cell may be a part, and a part empty
    for threads in (Threads(), Threads(3)):
        got = polar_from_fisheye(np.ones((200, 220, 3), np.float32), weights, threads)
        assert map_irradiance(got, "hemisphere")[0] == pytest.approx(2 * np.pi, rel=1e-3)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("mosaic", [None, *get_args(BayerPattern)])
def test_clipped_codes_are_counted_where_the_lens_sees_only(dtype: type, mosaic: BayerPattern | None) -> None:
    top = int(np.iinfo(dtype).max)
    codes = np.random.default_rng(3).choice(np.array([0, 1, top - 1, top], dtype), (200, 220))
    lattices = colour_lattices(mosaic) if mosaic else ((),)
    weights = [fisheye_to_polar(LENS, 45, 180, "sphere", lattice) if lattice else WEIGHTS for lattice in lattices]
    seen = codes.ravel()[np.unique(np.concatenate([each.pixel for each in weights]))]
    assert tuple(map(int, clipped_counts(codes, lit_runs(weights), top))) == (np.sum(seen == 0), np.sum(seen == top), top)
    outside = np.ones(codes.shape, dtype)
    outside.ravel()[np.setdiff1d(np.arange(outside.size), np.concatenate([each.pixel for each in weights]))] = 0
    assert clipped_counts(outside, lit_runs(weights), top)[0] == 0


def test_spans_hold_every_pixel_with_a_weight() -> None:
    y, x = np.divmod(WEIGHTS.pixel.astype(int), 220)
    spans = lit_spans([WEIGHTS])
    for row in np.unique(y):
        assert tuple(spans[row]) == (x[y == row].min(), x[y == row].max() + 1)
    assert (spans[np.setdiff1d(np.arange(200), y)] == 0).all()


def test_a_part_of_the_map_for_each_thread_that_the_settings_allow() -> None:
    msgspec.convert({"threads": MAP_PARTS}, Capture)
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"threads": MAP_PARTS + 1}, Capture)
