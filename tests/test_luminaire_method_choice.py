"""Which method draws a light field: by the errors that are measured on walls."""

import numpy as np
import pytest

from vemlight.renderer.luminaire import method_choice
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.luminaire_file import read_luminaire
from vemlight.renderer.luminaire.method_choice import EQUAL_SAMPLES, NOISE, SAMPLE_COUNTS, _Walls, chosen_method, spots_irradiance
from vemlight.renderer.luminaire.reference import irradiance, spot_irradiance
from vemlight.renderer.luminaire.shift_invariant import error_bound
from vemlight.renderer.luminaire.tables import summed_area_tables
from vemlight.renderer.scene.luminaire_table import BUNDLED_LAMP

DOWN = np.array([0.0, 0.0, -1.0])


def lobes(sharpness: float, pixels: int = 12, functions: int = 4, distance_m: float = 0.1) -> LightField:
    """A beam of functions one distance / 10 apart, each image a lobe of this sharpness."""
    x = (np.arange(pixels) + 0.5) / pixels * 2 - 1
    lobe = np.exp(-sharpness * (x[:, None] ** 2 + x**2))
    images = np.broadcast_to(lobe[..., None], (functions, functions, pixels, pixels, 3)).astype(np.float32)
    first = -(functions - 1) / 2 * 0.01
    return LightField(images.copy(), "bell", 0.01, (first, first), distance_m, (-0.2, -0.2, 0.2, 0.2), "radiometric", "lobes")


def test_the_spots_of_tables_are_those_of_the_definition():
    field, rng = lobes(2.0), np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (40, 2)), rng.uniform(0.15, 2.0, 40)])
    expected = np.array([spot_irradiance(field, point, DOWN) for point in points])
    np.testing.assert_allclose(spots_irradiance(field, summed_area_tables(field), points), expected, rtol=1e-5, atol=1e-6 * expected.max())
    on_plane = np.array([[0.013, -0.042, field.distance_m]])
    expected = spot_irradiance(field, on_plane[0], DOWN)
    np.testing.assert_allclose(spots_irradiance(field, summed_area_tables(field), on_plane)[0], expected, rtol=1e-3)


def test_the_walls_know_the_truth():
    walls = _Walls(lobes(4.0))
    chosen = slice(3, None, 21)
    exact = np.array([irradiance(lobes(4.0), point, DOWN)[1] for point in walls.points[chosen]])
    np.testing.assert_allclose(walls.truth[chosen], exact, rtol=0.1, atol=0.02 * exact.max())
    assert walls.error(walls.truth) == 0
    relative = walls.truth.reshape(4, -1) / walls.truth.reshape(4, -1).mean(axis=1, keepdims=True)
    assert walls.error(1.5 * walls.truth) == pytest.approx(0.5 * np.sqrt((relative**2).mean()))


def test_a_lamp_with_planes_of_ten_spacings_reaches_the_approximation():
    """Its bound alone, over half, would never let it."""
    field = read_luminaire(BUNDLED_LAMP)
    assert error_bound(field) > 0.4
    drawn = chosen_method(field, "auto", None)
    assert drawn.shift_invariant
    assert drawn.shift_invariant_error < drawn.sampling_error
    assert drawn.shift_invariant_error < 0.2


def test_auto_takes_whichever_is_truer_and_names_are_obeyed(monkeypatch):
    field = lobes(6.0, pixels=24)
    assert not chosen_method(field, "sampled", None).shift_invariant
    assert chosen_method(field, "shift-invariant", None).shift_invariant
    many = chosen_method(field, "auto", 4000)  # many samples are truer
    assert (many.shift_invariant, many.samples) == (False, 4000)
    errors = {"few": 0.2, "many": 0.1}
    for name, taken in (("few", True), ("many", False)):
        monkeypatch.setattr(_Walls, "approximated", lambda _: np.full(1, 0.15))
        monkeypatch.setattr(_Walls, "sampled", lambda _, count, error=errors[name]: np.full(1, error))
        monkeypatch.setattr(_Walls, "error", lambda _, values: float(values[0]))
        assert chosen_method(field, "auto", EQUAL_SAMPLES).shift_invariant == taken


def test_samples_are_as_many_as_their_noise_needs(monkeypatch):
    asked = []

    def sampled(_: _Walls, count: int) -> np.ndarray:
        asked.append(count)
        return np.full(1, 1.5 * np.sqrt(64 / count) * NOISE)

    monkeypatch.setattr(_Walls, "sampled", sampled)
    monkeypatch.setattr(_Walls, "error", lambda _, values: float(values[0]))
    assert chosen_method(lobes(6.0), "sampled", None).samples == 256
    monkeypatch.setattr(method_choice, "NOISE", 1e-9)
    assert chosen_method(lobes(6.0), "sampled", None).samples == SAMPLE_COUNTS[-1]
    asked.clear()
    assert chosen_method(lobes(6.0), "sampled", 77).samples == 77
    assert not asked


def test_a_dark_lamp_has_a_method():
    dark = lobes(6.0)._replace(images=np.zeros((4, 4, 12, 12, 3), np.float32))
    assert chosen_method(dark, "auto", None).shift_invariant
    assert chosen_method(dark, "sampled", None).samples == SAMPLE_COUNTS[0]
