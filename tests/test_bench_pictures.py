"""What is made of the pairs of the picture bench, without rendering any."""

import json

import numpy as np
import pytest

pytest.importorskip("mitsuba", reason="Mitsuba is in the bench extra")

from bench import pictures, ten_scenes
from bench.pictures import Setup, disc_map, page, summary, time_for, truth_of, turned
from vemlight.light.extent import Extents
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import latlong_solid_angles, rotation_xyz


def test_half_of_the_scenes_and_maps_are_kept_aside():
    assert len(ten_scenes.TUNED) == len(ten_scenes.KEPT_ASIDE) == 5
    assert not set(ten_scenes.TUNED) & set(ten_scenes.KEPT_ASIDE)
    assert len(pictures.KINDS) == len(pictures.PHOTOS_ASIDE) + len(pictures.PROCEDURAL) == 4


def test_turned_lights_keep_their_extents():
    directions = np.array([[0.6, 0.0, 0.8]])
    lights = LightSet.of(np.array([4]), directions, np.ones((1, 3)), np.array([[0.004, 0.0, -0.003, 0.03, 0.0, 0.00225]]))
    moved, turn = turned(lights, 90.0), rotation_xyz((0, 0, 90.0))
    np.testing.assert_allclose(moved.directions, directions @ turn.T, atol=1e-6)
    before, after = Extents.of(lights), Extents.of(moved)
    np.testing.assert_allclose(after.spreads, before.spreads, rtol=1e-5)
    for a, b in zip(after.axes[0], before.axes[0] @ turn.T, strict=True):
        assert abs(a @ b) == pytest.approx(a @ a, rel=1e-3)
    assert turned(lights._replace(covariances=None), 10.0).covariances is None


def test_a_disc_has_its_power():
    image = disc_map([((0.0, 1.0, 1.0), 20.0, (5.0, 5.0, 5.0))], (0.0, 0.0, 0.0))
    power = (image[..., 0] * latlong_solid_angles(512, 1024)[:, None]).sum()
    assert power == pytest.approx(5 * 2 * np.pi * (1 - np.cos(np.radians(10))), rel=0.01)


def test_the_truth_knows_its_own_noise(monkeypatch):
    def picture(world, samples, seed, method):
        return 1 + np.random.default_rng(seed).normal(0, 1 / np.sqrt(samples), (40, 50, 3))

    monkeypatch.setattr(pictures.mitsuba_picture, "picture", picture)
    off = np.full((40, 50, 3), 1.15)  # a fifth of the error is .03
    truth, noise, paths = truth_of(None, "mis", [off, off + 1], 16_384)
    assert paths in (1024, 1280)  # 1 / sqrt(1280) = .028, and 1 / sqrt(1024) = .031
    assert noise == pytest.approx(np.std(truth), rel=0.05)
    assert noise <= 0.2 * np.sqrt(np.mean((off - truth) ** 2) / np.mean(truth**2))
    assert truth_of(None, "mis", [np.ones((40, 50, 3))], 512)[2] == 512


def row(name: str, rmse: float, ms: float) -> dict:
    return {"picture": name, "rmse": rmse, "flip": rmse, "lab": 1.0, "ms": ms, "processor_ms": ms}


ROWS = [
    row("vemlight, default", 0.02, 50.0), row("Embree, default", 0.03, 100.0),
    row("Mitsuba emitter, 1", 0.4, 10.0), row("Mitsuba emitter, 4", 0.2, 40.0), row("Mitsuba emitter, 16", 0.1, 160.0),
    row("Mitsuba mis, 1", 0.2, 20.0), row("Mitsuba mis, 16", 0.05, 320.0), row("Mitsuba mis, 256", 0.0125, 5120.0),
]  # fmt: skip


def test_the_time_for_an_error_lies_on_the_line_between_measured_ones():
    assert time_for(ROWS[2:5], 0.2 / 2**0.5) == pytest.approx(80.0)
    assert time_for(ROWS[2:5], 0.05) == np.inf
    assert time_for(ROWS[2:5], 0.9) == pytest.approx(10.0)
    assert time_for([], 0.1) == np.inf


def test_the_best_method_counts_and_noise_is_said(tmp_path):
    setup = Setup(8, 6, 0, 2, 512)
    kept = {"setup": setup._asdict(), "scene": "street", "map": "a sun", "noise": 0.003, "paths": 512, "rows": ROWS}
    line = summary(kept)
    assert line["default: best rival"] == "Mitsuba mis"
    assert line["default: rival over ours"] == pytest.approx(2000 / 50)
    assert line["default: Embree over ours"] == 2.0
    assert line["scene kept aside"]
    assert not line["noise small enough"]  # above a fifth of .0125
    (tmp_path / "pairs").mkdir()
    (tmp_path / "pairs" / "street__a_sun__0.json").write_text(json.dumps(kept))
    assert len(page(tmp_path, {"a sun": (tmp_path, False)})) == 1
    text = (tmp_path / "index.html").read_text()
    assert "street, a sun, 0 bounces (kept aside: scene)" in text
    assert "too much for the least errors" in text
    assert "default: rmse" in (tmp_path / "pictures.csv").read_text()
