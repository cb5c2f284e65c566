"""Shares of an archive's chunks, for the machines of a job: which are whose."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from vemlight.commands.archive.archiving import archive
from vemlight.commands.cli import main
from vemlight.commands.options import ArchiveOptions
from vemlight.light.images import write_exr

FRAMES = 4


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    for k in range(FRAMES):
        write_exr(folder / f"sky_{k:04d}.exr", np.random.default_rng(k).random((16, 32, 3)).astype(np.float32))
    return folder


@pytest.fixture(scope="module")
def mapped(recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive's folder with all maps, made by two shares of the chunks, and no lights."""
    out = tmp_path_factory.mktemp("mapped") / "archive"
    for index in (1, 0):
        archive(ArchiveOptions(source=recording, out=out, chunk=1, workers=1, maps_only=True, index=index, indices=2))
    return out


@pytest.mark.parametrize(
    ("environment", "options", "said"),
    [
        ({"JOB_COMPLETION_INDEX": "1"}, ["--maps-only", "--indices", "2"], "maps of 2 of 4 chunks, 1 of 2"),
        ({"JOB_COMPLETION_INDEX": "7"}, ["--maps-only", "--indices", "2", "--index", "0"], "maps of 2 of 4 chunks, 0 of 2"),
        ({"JOB_COMPLETION_INDEX": "2"}, ["--maps-only", "--indices", "2"], "--index 2: is not below --indices 2"),
        ({"JOB_COMPLETION_INDEX": "x"}, ["--maps-only", "--indices", "2"], "JOB_COMPLETION_INDEX=x: is no index of a job"),
        ({"JOB_COMPLETION_INDEX": "1"}, ["--maps-only"], "--indices: is missing beside JOB_COMPLETION_INDEX=1"),
        ({"JOB_COMPLETION_INDEX": "9"}, ["--from-maps"], "lights of 4 frames"),  # the job's own number means nothing there
    ],
)
def test_the_index_of_a_job_says_which_chunks(recording, mapped, tmp_path, environment, options, said):
    out = Path(shutil.copytree(mapped, tmp_path / "a"))
    done = CliRunner().invoke(main, ["archive", str(recording), "--out", str(out), *options], env=environment)
    assert said in done.output
    assert done.exit_code == (2 if ": is" in said else 0), done.output


def test_shares_of_the_chunks_make_all_of_them_once(mapped):
    assert {path.name for path in mapped.iterdir() if path.name.startswith("maps")} == {f"maps_{k:06d}" for k in range(FRAMES)}
