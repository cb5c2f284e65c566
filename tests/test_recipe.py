"""The bundled sequences."""

from pathlib import Path

import pytest

from vemlight.capture.lens import read_lens
from vemlight.capture.manifest import read_manifest
from vemlight.capture.simulation.recipe import remake
from vemlight.errors import UserError
from vemlight.light.images import read_radiance

REPLAY = Path(__file__).parents[1] / "replay_data"


@pytest.mark.parametrize("name", ["outdoor", "interior"])
def test_recipe_makes_the_bundled_frames_again(tmp_path: Path, name: str) -> None:
    remake(REPLAY / name, tmp_path, frames=3)
    made = sorted(tmp_path.glob("*.exr"))
    assert len(made) == 3
    for path in made:
        assert read_radiance(path)[0].tobytes() == read_radiance(REPLAY / name / path.name)[0].tobytes()
    assert len((REPLAY / name / "truth.jsonl").read_text().splitlines()) == 48
    assert read_manifest(tmp_path) == read_manifest(REPLAY / name)[:3]
    assert read_lens(tmp_path / "lens.toml") == read_lens(REPLAY / name / "lens.toml")


def test_bundled_sequences_are_small() -> None:
    assert sum(path.stat().st_size for path in REPLAY.rglob("*") if path.is_file()) <= 8e6


def test_unknown_key_is_refused(tmp_path: Path) -> None:
    (tmp_path / "recipe.toml").write_text('scene = "sky"\nframes = 1\nfps = 24.0\nsun = 2\n')
    with pytest.raises(UserError, match=r"recipe\.toml.*sun"):
        remake(tmp_path, tmp_path)
