"""The fisheye lens and its file."""

import tomllib
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from vemlight.capture.lens import (
    Lens,
    check_lens,
    direction_from_pixel,
    pixel_angles,
    pixel_from_direction,
    pixel_solid_angles,
    radius_from_angle,
    read_lens,
    slope_from_angle,
    write_lens,
)
from vemlight.errors import UserError
from vemlight.light.sphere import angle_between, direction_from_angles, rotation_xyz


def make_lens(size: int = 200, rim_deg: float = 95.0, **changes: object) -> Lens:
    """An equidistant lens whose rim touches the image's border."""
    f = (size / 2 - 1) / np.radians(rim_deg)
    lens = Lens(size=(size, size), f=(f, f), c=((size - 1) / 2, (size - 1) / 2), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=rim_deg)
    return msgspec.structs.replace(lens, **changes)


@given(
    k1=st.floats(-0.03, 0.08),
    k2=st.floats(-0.003, 0.01),
    theta=st.floats(0, np.pi - 1e-6),
    phi=st.floats(0, 2 * np.pi),
)
def test_pixel_and_direction_are_inverse_all_around(k1: float, k2: float, theta: float, phi: float) -> None:
    lens = make_lens(rim_deg=110.0, k1=k1, k2=k2, f=(60.0, 61.0), c=(98.2, 101.7))
    check_lens(lens)
    direction = direction_from_angles(theta, phi)
    back = direction_from_pixel(pixel_from_direction(direction, lens), lens)
    assert angle_between(direction, back) < 1e-9  # rad; the slope of theta_d is above 0.2 here and float64 has 1e-16


DECENTRED = {"p1": 0.012, "p2": -0.008, "p3": 0.1, "k1": 0.02, "f": (60.0, 61.0), "c": (98.2, 101.7)}


@given(
    p1=st.floats(-0.02, 0.02),
    p2=st.floats(-0.02, 0.02),
    p3=st.floats(-0.1, 0.1),
    theta=st.floats(0, np.pi - 1e-6),
    phi=st.floats(0, 2 * np.pi),
)
def test_pixel_and_direction_are_inverse_off_centre(p1: float, p2: float, p3: float, theta: float, phi: float) -> None:
    lens = make_lens(rim_deg=110.0, **{**DECENTRED, "p1": p1, "p2": p2, "p3": p3})
    check_lens(lens)
    direction = direction_from_angles(theta, phi)
    back = direction_from_pixel(pixel_from_direction(direction, lens), lens)
    assert angle_between(direction, back) < 1e-9
    near = direction_from_angles(np.array([lens.rim - 1e-9, lens.rim + 1e-9]), np.full(2, phi))  # and no step at the rim
    assert np.linalg.norm(np.diff(pixel_from_direction(near, lens), axis=0)) < 1e-5


def test_decentring_is_browns() -> None:
    lens = make_lens(**DECENTRED, rim_deg=110.0)
    theta, phi = 1.2, 0.7
    radius = theta * (1 + 0.02 * theta**2)
    u, v = radius * np.cos(phi), radius * np.sin(phi)
    m = 1 + 0.1 * radius**2
    du = (2 * 0.012 * u * v - 0.008 * (radius**2 + 2 * u**2)) * m
    dv = (0.012 * (radius**2 + 2 * v**2) - 2 * 0.008 * u * v) * m
    expected = [98.2 + 60 * (u + du), 101.7 + 61 * (v + dv)]
    np.testing.assert_allclose(pixel_from_direction(direction_from_angles(theta, phi), lens), expected, rtol=1e-12)


def test_known_projection() -> None:
    # equidistant: 90 degrees off the axis lies at f pi / 2 from the centre, 135 at f 3 pi / 4
    lens = make_lens(f=(30.0, 30.0), c=(100.0, 100.0), rim_deg=140.0)
    directions = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, -1]], float)
    expected = [[100, 100], [100 + 15 * np.pi, 100], [100, 100 + 15 * np.pi], [100 - 22.5 * np.pi, 100]]
    np.testing.assert_allclose(pixel_from_direction(directions, lens), expected, atol=1e-9)


def test_axis_and_straight_behind_have_a_pixel() -> None:
    lens = make_lens()
    pixels = pixel_from_direction(np.array([[0.0, 0, 1], [0, 0, -1]]), lens)
    assert np.all(np.isfinite(pixels))
    np.testing.assert_allclose(direction_from_pixel(pixels, lens), [[0, 0, 1], [0, 0, -1]], atol=1e-12)


def test_slope_is_the_derivative_up_to_the_rim_and_constant_beyond() -> None:
    lens = make_lens(rim_deg=100.0, k1=0.02, k2=-0.01, k3=0.004, k4=0.0005)
    theta, h = np.linspace(0.1, 2.5, 25), 1e-5
    slope = [(radius_from_angle(t + h, lens.intrinsics) - radius_from_angle(t - h, lens.intrinsics)) / (2 * h) for t in theta]
    np.testing.assert_allclose(slope, slope_from_angle(np.minimum(theta, lens.rim), lens), rtol=1e-8)


@pytest.mark.parametrize("k1", [0.0, -0.02, 0.06])
def test_solid_angles_add_up_to_the_cap(k1: float) -> None:
    lens = make_lens(500, 100.0, k1=k1, f=(110.0, 113.0))
    cap = 2 * np.pi * (1 - np.cos(lens.rim))
    # the rim's pixels are in or out by their centres: half a pixel of noise on a circle of 1300 pixels
    assert pixel_solid_angles(lens).sum() == pytest.approx(cap, rel=2e-4)


@pytest.mark.parametrize("decentring", [{}, {"p1": -0.015, "p2": 0.01, "p3": 0.2}])
def test_solid_angle_is_the_area_between_corner_rays(decentring: dict) -> None:
    lens = make_lens(100, 110.0, k1=0.03, k2=-0.002, f=(22.0, 23.0), **decentring)
    for x, y in ((50, 50), (20, 40), (70, 85), (49, 3)):
        n = 40
        u, v = np.meshgrid(np.linspace(-0.5, 0.5, n + 1), np.linspace(-0.5, 0.5, n + 1))
        rays = direction_from_pixel(np.stack([x + u, y + v], -1), lens)
        sides = np.cross(rays[1:, 1:] - rays[:-1, :-1], rays[1:, :-1] - rays[:-1, 1:])
        area = np.linalg.norm(sides, axis=-1).sum() / 2
        # a pixel here is 2.6 degrees: h^2 / 24 = 9e-5, and the lens's bend adds some
        assert pixel_solid_angles(lens)[y, x] == pytest.approx(area, rel=1e-3)


def test_nothing_beyond_the_rim() -> None:
    lens = make_lens(100, 80.0)
    assert np.all((pixel_solid_angles(lens) > 0) == (pixel_angles(lens) <= lens.rim))


@given(
    numbers=st.lists(st.floats(1e-6, 1e6), min_size=4, max_size=4),
    vignetting=st.lists(st.floats(-0.02, 0.1), max_size=3),
    date=st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=20),
)
def test_lens_file_round_trip(tmp_path_factory: pytest.TempPathFactory, numbers: list[float], vignetting: list[float], date: str) -> None:
    path = tmp_path_factory.mktemp("lens") / "lens.toml"
    rotation = tuple(tuple(map(float, row)) for row in rotation_xyz((10, 20, 30)))
    lens = make_lens(
        f=tuple(numbers[:2]), c=tuple(numbers[2:]), vignetting=tuple(vignetting), date=date, world_from_camera=rotation, k1=1 / 3
    )
    write_lens(path, lens)
    assert read_lens(path) == lens


@pytest.mark.parametrize("key", ["size", "f", "c", "k1", "k4", "rim_deg"])
def test_missing_key_is_named(tmp_path: Path, key: str) -> None:
    path = tmp_path / "lens.toml"
    write_lens(path, make_lens())
    content = tomllib.loads(path.read_text())
    del content[key]
    path.write_text(tomli_w.dumps(content))
    with pytest.raises(UserError, match=f"lens.toml.*{key}"):
        read_lens(path)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"k1": -0.2}, "turn back"),
        ({"k2": -0.05}, "turn back"),
        ({"p1": 0.2}, "p1..p3 bend"),
        ({"p2": 0.01, "p3": 30.0}, "p1..p3 bend"),
        ({"p1": float("inf")}, "p1 = inf"),
        ({"vignetting": (-0.5,)}, "vignetting"),
        ({"rim_deg": 0.0}, "rim_deg"),
        ({"f": (0.0, 1.0)}, "f ="),
        ({"c": (float("nan"), 1.0)}, "nan"),
        ({"size": (0, 10)}, "size"),
        ({"size": (16385, 10)}, "size"),
        ({"rim_deg": 180.1}, "rim_deg"),
        ({"world_from_camera": ((1.0, 0, 0), (0, 1.0, 0), (0, 0, -1.0))}, "world_from_camera"),
        ({"world_from_camera": ((1.0000075, 0, 0), (0, 1.0, 0), (0, 0, 1.0))}, "world_from_camera"),
        ({"flat_field": "flat.exr", "vignetting": (-0.1,)}, "leave one of the two out"),
    ],
)
def test_no_lens_at_all_is_refused(tmp_path: Path, changes: dict, word: str) -> None:
    path = tmp_path / "lens.toml"
    write_lens(path, msgspec.structs.replace(make_lens(), **changes))
    with pytest.raises(UserError, match=word):
        read_lens(path)


def test_unknown_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lens.toml"
    write_lens(path, make_lens())
    path.write_text(path.read_text() + "k5 = 0.0\n")
    with pytest.raises(UserError, match="k5"):
        read_lens(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"size": (16384, 10)},
        {"rim_deg": 180.0},
        {"world_from_camera": ((1.000003, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))},  # six digits
    ],
)
def test_a_lens_at_the_limits_is_read(tmp_path: Path, changes: dict) -> None:
    lens = msgspec.structs.replace(make_lens(), **changes)
    write_lens(tmp_path / "lens.toml", lens)
    assert read_lens(tmp_path / "lens.toml") == lens


@pytest.mark.parametrize("changes", [{"k1": 1e308, "k2": -1e308}, {"vignetting": (1e308, -1e308)}, {"k4": 1e308}])
def test_numbers_beyond_all_lenses_are_refused_without_a_warning(changes):
    with pytest.raises(UserError, match=r"turn back|falls to 0"):
        check_lens(make_lens(**changes))
