"""The map's luminance as numbers for the page: small, true to the light there is, whatever the map's size."""

import numpy as np
import pytest

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.sphere import Coverage, cell_solid_angles, map_irradiance
from vemlight.runtime import stamps, wire
from vemlight.viewer.sky_values import COVERAGES, HEAD, MAX_CELLS, sky_values


def read(values: bytes) -> tuple[int, int, int, float, float, np.ndarray]:
    word, rows, cols, coverage, _, scale, total = HEAD.unpack_from(values)
    assert word == b"sky1"
    return rows, cols, coverage, scale, total, np.frombuffer(values, "<f4", offset=HEAD.size).reshape(rows, cols)


def message(rows: int, cols: int, coverage: Coverage = "hemisphere", scale: float | None = None) -> wire.MapMessage:
    return wire.MapMessage(stamp=stamps.stamp(0, 0.0), rows=rows, cols=cols, coverage=coverage, luminance_scale=scale)


@pytest.mark.parametrize("coverage", COVERAGES)
@pytest.mark.parametrize(("rows", "cols"), [(2, 4), (90, 360), (91, 361), (180, 360), (512, 1024)])
def test_the_power_of_its_cells_is_the_maps(rows, cols, coverage):
    radiance = np.random.default_rng(rows).lognormal(0, 1.5, (rows, cols, 3)).astype(np.float32)
    fewer, across, kind, scale, total, luminance = read(sky_values(message(rows, cols, coverage), radiance))
    assert fewer * across <= MAX_CELLS
    assert (fewer, across) == (rows, cols) if rows * cols <= MAX_CELLS else fewer < rows
    assert COVERAGES[kind] == coverage
    assert scale == 0  # not calibrated
    assert total == pytest.approx(luminance_from_rgb(map_irradiance(radiance, coverage)), rel=1e-5)
    power = float((luminance.astype(float) * cell_solid_angles(fewer, across, coverage)[:, None]).sum())
    assert power == pytest.approx(total, rel=0.02)


def test_an_even_map_stays_even_and_its_scale_is_said():
    *_, scale, _, luminance = read(sky_values(message(333, 777, scale=179.0), np.full((333, 777, 3), 0.25, np.float32)))
    assert scale == 179.0
    assert np.allclose(luminance, 0.25, rtol=1e-5)


def test_the_brightest_map_is_finite():
    *_, luminance = read(sky_values(message(90, 360), np.full((90, 360, 3), 3e38, np.float32)))
    assert np.isfinite(luminance).all()
