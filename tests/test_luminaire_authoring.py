from pathlib import Path

import numpy as np
import pytest

from tests.support.ray_files import LUMINOUS, ray_file
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.luminaire.acquisition import FluxBudget
from vemlight.renderer.luminaire.authoring import RayOptions, from_rays, made_up, measure
from vemlight.renderer.luminaire.goniophotometer import ReflectorLamp, lamp_rays
from vemlight.renderer.luminaire.inspection import contact_sheet, describe, intensity_by_angle, lit_planes, write_pictures
from vemlight.renderer.luminaire.lightfield import flux
from vemlight.renderer.luminaire.luminaire_file import read_luminaire
from vemlight.renderer.scene import luminaire_table as placement

RECIPE = placement.BUNDLED_LAMP.with_suffix(".toml")


def test_the_recipe_makes_the_bundled_lamp_again(tmp_path):
    made = measure(RECIPE, tmp_path / "torch.exr")
    bundled = read_luminaire(placement.BUNDLED_LAMP)
    assert made[1:] == bundled[1:]
    # 16-bit numbers; a ray on the edge of the ball may hit on one machine and miss on another
    assert np.abs(made.images - bundled.images).mean() < 1e-3 * np.abs(bundled.images).mean()
    assert placement.BUNDLED_LAMP.stat().st_size < 300_000


@pytest.mark.parametrize(("old", "new", "said"), [
    ('basis = "bell"', 'basis = "haar"', "basis"),
    ("rows = 5", "rows = 0", "rows"), ('dual = "compact"', "dual_width = 1.0", "dual_width"),
    ("half = true", "sharp = true", "sharp"),
    ("radiance = [4.0e6", "radiance = [4.0e9", "65504"), ('basis = "bell"', 'basis = "b-spline"\nx = 1', "x"),
])
def test_a_bad_recipe_is_refused(tmp_path, old, new, said):
    text = RECIPE.read_text()
    assert old in text
    (tmp_path / "bad.toml").write_text(text.replace(old, new).replace("width = 48\nheight = 48", "width = 4\nheight = 4"))
    with pytest.raises(UserError, match=said) as caught:
        measure(tmp_path / "bad.toml", tmp_path / "out.exr")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out.exr").exists()


@pytest.fixture
def rays(tmp_path) -> Path:
    rays = lamp_rays(ReflectorLamp(), 60_000, 1.5, 1)
    lit = luminance_from_rgb(rays.flux) > 0
    rows = np.hstack([rays.positions[lit] * 1e3, rays.directions[lit], luminance_from_rgb(rays.flux[lit])[:, None]])
    return ray_file(tmp_path / "lamp.tm25ray", rows, LUMINOUS)


def test_rays_become_a_lamp_that_keeps_its_flux(tmp_path, rays):
    made = from_rays(rays, tmp_path / "lamp.exr", RayOptions(functions=7, pixels=20))
    assert made.header_flux == pytest.approx(made.flux_budget.total, rel=1e-5)
    assert sum(made.flux_budget[1:]) == pytest.approx(made.flux_budget.total, rel=1e-9)
    assert made.flux_budget.captured > 0.95 * made.flux_budget.total
    forward = made.flux_budget.total - made.flux_budget.backward
    assert luminance_from_rgb(flux(made.field)) == pytest.approx(forward, rel=1e-4)  # what the filters took is made up for
    assert luminance_from_rgb(flux(read_luminaire(tmp_path / "lamp.exr"))) == pytest.approx(forward, rel=1e-4)


@pytest.mark.parametrize("options", [{"functions": 1}, {"pixels": 0}, {"angle_deg": 90.0}])
def test_options_that_cannot_be_are_refused(tmp_path, rays, options):
    with pytest.raises(UserError, match="correct the option"):
        from_rays(rays, tmp_path / "lamp.exr", RayOptions(**options))


def test_rays_away_from_the_planes_are_refused(tmp_path):
    rows = np.array([[0, 0, 0, 0, 0, -1, 5], [1, 0, 0, 0, 0.6, -0.8, 7]], float)
    with pytest.raises(UserError, match="turn the set"):
        from_rays(ray_file(tmp_path / "down.tm25ray", rows, LUMINOUS), tmp_path / "lamp.exr")


def test_pictures_and_a_report_of_the_bundled_lamp(tmp_path):
    field = read_luminaire(placement.BUNDLED_LAMP)
    assert contact_sheet(field).shape == (240, 240, 3)
    planes = lit_planes(field, (0.1, 0.5), 16)
    assert planes.shape == (16, 32, 3)
    assert planes[:, :16].max() == planes[:, 16:].max() == 255
    theta, value = intensity_by_angle(field, 5.0)
    # the intensity's integral over the hemisphere is the flux; 5 degrees of a beam that falls within 10 leave a few percent
    whole = np.trapezoid(value * np.sin(np.radians(theta)), np.radians(theta)) * 2 * np.pi
    assert whole == pytest.approx(luminance_from_rgb(flux(field)), rel=0.05)
    text = "\n".join(describe(placement.BUNDLED_LAMP))
    assert "5 x 5 images of 48 x 48" in text
    assert "rendered shift-invariant" in text
    assert all(path.is_file() for path in write_pictures(placement.BUNDLED_LAMP, tmp_path / "pictures"))


def test_the_functions_reach_over_98_percent_of_the_flux_and_the_planes_are_ten_spacings_apart(tmp_path):
    """Upward rays from an even line of 1000 places: 98 % of them start within 0.98 of its half length."""
    x = np.linspace(-10, 10, 1001)
    slope = np.linspace(-0.2, 0.2, 1001)[np.random.default_rng(1).permutation(1001)]
    directions = np.stack([slope, 0 * x, np.ones(1001)], axis=1) / np.sqrt(1 + slope**2)[:, None]
    rows = np.hstack([np.stack([x, 0 * x, 0 * x], axis=1), directions, np.ones((1001, 1))])
    path = ray_file(tmp_path / "line.tm25ray", rows, LUMINOUS)
    field = from_rays(path, tmp_path / "line.exr", RayOptions(functions=9, pixels=4, plane_z_m=0.0)).field
    assert field.spacing_m == pytest.approx(0.0098 / 3, rel=2e-3)
    assert field.distance_m == pytest.approx(10 * field.spacing_m)


def test_only_little_that_leaves_elsewhere_is_made_up_for():
    assert made_up(FluxBudget(100.0, 96.0, 0.0, 1.0, 2.0, 1.0)) == pytest.approx(100 / 96)
    assert made_up(FluxBudget(100.0, 40.0, 10.0, 3.0, 45.0, 2.0)) == pytest.approx(45 / 40)
    assert made_up(FluxBudget(100.0, 0.0, 100.0, 0.0, 0.0, 0.0)) == 1.0
