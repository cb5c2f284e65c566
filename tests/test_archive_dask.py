"""Archives by the workers of a Dask scheduler: the same bytes. Skipped where Dask, an optional package, is not installed."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from vemlight.commands.archive.archiving import archive
from vemlight.commands.offline import write_lights_file
from vemlight.commands.options import ArchiveOptions, LightsOptions
from vemlight.errors import UserError
from vemlight.light.images import write_exr

FRAMES = 9


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    for k in range(FRAMES):
        sky = np.random.default_rng(k).uniform(0.4, 0.5, (16, 32, 3)).astype(np.float32)
        sky[4, k] = 300
        write_exr(folder / f"sky_{k:04d}.exr", sky)
    return folder


@pytest.fixture(scope="module")
def scheduler():
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install 'vemlight[dask]'")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


def test_dask_workers_make_the_same_bytes(recording, scheduler, tmp_path):
    write_lights_file(LightsOptions(source=recording, out=tmp_path / "l.jsonl"))
    archive(ArchiveOptions(source=recording, out=tmp_path / "a", chunk=2, scheduler=scheduler))
    assert (tmp_path / "a" / "lights.jsonl").read_bytes() == (tmp_path / "l.jsonl").read_bytes()


def test_a_damaged_frame_of_a_dask_worker_is_named_and_what_came_before_it_stays(recording, scheduler, tmp_path):
    source, out = Path(shutil.copytree(recording, tmp_path / "r")), tmp_path / "a"
    (source / "sky_0005.exr").write_bytes(b"")
    with pytest.raises(UserError, match=r"sky_0005\.exr.*keeps the 2 chunks before it"):
        archive(ArchiveOptions(source=source, out=out, chunk=2, scheduler=scheduler))
    shutil.copyfile(recording / "sky_0005.exr", source / "sky_0005.exr")
    archive(ArchiveOptions(source=source, out=out, scheduler=scheduler))
    assert (out / "lights.jsonl").is_file()


def test_without_dask_one_line_says_how_to_install_it(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UserError, match=r"--scheduler: Dask is not installed; pip install 'vemlight\[dask\]'"):
        archive(ArchiveOptions(source=recording, out=tmp_path / "a", scheduler="tcp://127.0.0.1:9"))
    assert not (tmp_path / "a").exists()
