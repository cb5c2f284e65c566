import os
from pathlib import Path

import numpy as np
import pytest

from tests.support.ray_files import LUMINOUS, ray_file
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.luminaire.acquisition import AcquisitionPlanes, field_from_rays, waist_z_m
from vemlight.renderer.luminaire.lightfield import flux
from vemlight.renderer.luminaire.rayfile import TM25_HEADER, colour_of_spectrum, read_rays

LED = "luminaire/rayfile_LERTDUW_S2WP_green_100k_20161013_IES_TM25.TM25RAY"


ROWS = np.array([[1, 2, 3, 0, 0.6, 0.8, 5], [-1, 0, 0, 0, 0, 1, 7]], float)


def test_positions_are_metres_and_flux_is_lumens(tmp_path):
    file = read_rays(ray_file(tmp_path / "a.tm25ray", ROWS, LUMINOUS))
    assert file.name == "a lamp"
    assert file.photometric
    assert file.header_flux == 12
    assert np.allclose(file.rays.positions, ROWS[:, :3] * 1e-3)
    assert np.allclose(file.rays.directions, ROWS[:, 3:6])
    assert np.allclose(luminance_from_rgb(file.rays.flux), [5, 7])


def test_the_flags_say_where_the_flux_stands(tmp_path):
    # radiant flux, three Stokes items and wavelength come before luminous flux; X, Z, the spectrum's index and more after it
    rows = np.hstack([ROWS[:, :6], np.full((2, 5), 9.0), [[5], [7]], np.full((2, 4), 9.0)])
    file = read_rays(ray_file(tmp_path / "a.tm25ray", rows, [1, 1, 1, 1, 1, 1, 1, 1], additional_items=1))
    assert np.allclose(luminance_from_rgb(file.rays.flux), [5, 7])
    radiant = read_rays(ray_file(tmp_path / "b.tm25ray", ROWS, [1, 1, 1, 0, 0, 0, 0, 0], radiant_flux=12))
    assert not radiant.photometric
    assert radiant.header_flux == 12


def test_a_spectrum_gives_the_colour(tmp_path):
    nm = np.arange(380.0, 781.0, 5.0)
    for weight, brightest in ((nm > 620, 0), (np.abs(nm - 540) < 10, 1), (nm < 460, 2)):
        file = read_rays(ray_file(tmp_path / "a.tm25ray", ROWS, LUMINOUS, np.stack([nm, weight], axis=-1), spectra=1))
        assert np.argmax(file.rays.flux[0]) == brightest
        assert np.allclose(luminance_from_rgb(file.rays.flux), [5, 7])
    assert np.allclose(colour_of_spectrum(nm, np.zeros(len(nm))), 1)
    # equal energy is nearly white: x = y = 1/3 against 0.3127, 0.3290
    assert np.allclose(colour_of_spectrum(nm, np.ones(len(nm))), [1.2, 0.95, 0.91], atol=0.03)


@pytest.mark.parametrize("fields", [{"magic": b"TM26"}, {"rays": 0}, {"rays": 3}, {"rays": 2**60}, {"additional_items": -1},
                                    {"additional_items": 500}, {"flags": [0] * 8}, {"flags": [1, 1, 0, 0, 0, 0, 0, 0]}])
def test_a_damaged_header_is_refused(tmp_path, fields):
    rows = np.concatenate([ROWS] * 2000) if fields.get("additional_items") == 500 else ROWS
    path = ray_file(tmp_path / "bad.tm25ray", rows, fields.pop("flags", LUMINOUS), **({"rays": len(rows)} | fields))
    if fields.get("rays") == 3:  # the third ray would begin in the padding of the texts
        path.write_bytes(path.read_bytes()[: TM25_HEADER.itemsize + 56])
    with pytest.raises(UserError, match=r"bad\.tm25ray"):
        read_rays(path)


@pytest.mark.parametrize(("column", "value"), [(0, np.nan), (3, np.inf), (4, 0.9), (6, -1.0), (6, np.nan)])
def test_rays_that_cannot_be_are_refused(tmp_path, column, value):
    rows = ROWS.copy()
    rows[1, column] = value
    with pytest.raises(UserError, match="nan, negative"):
        read_rays(ray_file(tmp_path / "bad.tm25ray", rows, LUMINOUS))


@pytest.mark.skipif("VEMLIGHT_DATA" not in os.environ, reason="VEMLIGHT_DATA names no folder with real data")
def test_a_real_led_keeps_its_337_lumens():
    file = read_rays(Path(os.environ["VEMLIGHT_DATA"]) / LED)
    assert file.header_flux == 337
    assert luminance_from_rgb(file.rays.flux).sum() == pytest.approx(337, rel=1e-6)
    planes = AcquisitionPlanes("bell", 0.5e-3, 9, 9, 5e-3, (0.02, 0.02), 24, 24)
    field, flux_budget = field_from_rays(file.rays, planes, waist_z_m(file.rays), "photometric", file.name)
    assert sum(flux_budget[1:]) == pytest.approx(337, rel=1e-6)
    assert flux_budget.captured > 0.95 * 337  # what left: rays flatter than 76 degrees and stray light beside the chip
    assert luminance_from_rgb(flux(field)) == pytest.approx(flux_budget.captured, rel=1e-5)


@pytest.mark.parametrize(("length", "accepted"), [(1.0007, True), (1.0015, False)])
def test_directions_are_unit_vectors_to_a_thousandth(tmp_path, length, accepted):
    rows = ROWS * [1, 1, 1, length, length, length, 1]
    path = ray_file(tmp_path / "a.tm25ray", rows, LUMINOUS)
    if accepted:
        assert np.linalg.norm(read_rays(path).rays.directions, axis=1) == pytest.approx(1)
    else:
        with pytest.raises(UserError, match="unit vectors"):
            read_rays(path)


@pytest.mark.parametrize(("fields", "said"), [
    ({"rays": 2**28}, "was cut off"), ({"rays": 2**28 + 1}, "header claims"),
    ({"additional_items": 999}, "unit vectors"), ({"additional_items": 1000}, "header claims"),
])
def test_a_header_that_claims_too_much_is_refused_before_anything_is_read(tmp_path, fields, said):
    with pytest.raises(UserError, match=said):
        read_rays(ray_file(tmp_path / "a.tm25ray", ROWS, LUMINOUS, **fields))


@pytest.mark.parametrize(("count", "read"), [(10_000, True), (10_001, False)])
def test_a_spectrum_has_up_to_10000_wavelengths(tmp_path, count, read):
    nm = np.linspace(620, 700, count)
    file = read_rays(ray_file(tmp_path / "a.tm25ray", ROWS, LUMINOUS, np.stack([nm, np.ones(count)], axis=-1), spectra=1))
    assert (file.rays.flux[0, 0] > 2 * file.rays.flux[0, 1]) == read
