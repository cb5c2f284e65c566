"""Rotation of the light about the virtual camera."""

from pathlib import Path

import numpy as np
import pytest

from vemlight.capture.simulation.motion import motion
from vemlight.errors import UserError


def write(path: Path, *keys: str) -> Path:
    path.write_text("".join(f"[[key]]\n{key}\n" for key in keys))
    return path


def test_even_turn_goes_from_x_to_y() -> None:
    np.testing.assert_allclose(motion(45.0, None)(2.0) @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_keys_are_met_and_between_them_the_turn_is_even(tmp_path: Path) -> None:
    turned = motion(0.0, write(tmp_path / "k.toml", "time_s = 1\nrotate_deg = [0, 0, 10]", "time_s = 3\nrotate_deg = [0, 0, 50]"))
    for time_s, degrees in ((0.0, 10), (1.0, 10), (2.5, 40), (3.0, 50), (9.0, 50)):
        angle = np.radians(degrees)
        np.testing.assert_allclose(turned(time_s) @ [1, 0, 0], [np.cos(angle), np.sin(angle), 0], atol=1e-9)


def test_one_key_rests(tmp_path: Path) -> None:
    turned = motion(0.0, write(tmp_path / "k.toml", "time_s = 0\nrotate_deg = [90, 0, 0]"))
    np.testing.assert_allclose(turned(5.0) @ [0, 1, 0], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    "keys", [[], ["time_s = 1\nrotate_deg = [0, 0, 0]", "time_s = 1\nrotate_deg = [0, 0, 1]"], ["time_s = 1\nrotate_deg = [0]"]]
)
def test_bad_keys(tmp_path: Path, keys: list[str]) -> None:
    with pytest.raises(UserError, match=r"k\.toml"):
        motion(0.0, write(tmp_path / "k.toml", *keys))
