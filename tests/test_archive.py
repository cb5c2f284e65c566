"""`vemlight archive`: the bytes of `vemlight lights` whatever the chunks, workers and interruptions, and what stands in its folder."""

import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from io import BytesIO
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.processes import vemlight
from vemlight.commands.archive import archiving, workers
from vemlight.commands.archive.archiving import archive
from vemlight.commands.archive.chunks import ChunkMaker
from vemlight.commands.archive.map_file import MapReader, write_maps
from vemlight.commands.archive.plan import keep_plan
from vemlight.commands.offline import write_lights_file
from vemlight.commands.options import ArchiveOptions, LightsOptions
from vemlight.errors import FatalError, Interrupted, UserError
from vemlight.light.images import write_exr

FRAMES = 20
METHODS = {
    "tracked": {},
    "standard": {"method": "standard", "count": 12, "filter": "iir", "deflicker": True},
    "havran": {"method": "havran-azimuth", "count": 24, "error_percent": 20.0, "clusters": 6},
}


def write_frame(path: Path, k: int) -> None:
    """A sky with a sun that moves and a lamp that flickers."""
    sky = np.random.default_rng(k).uniform(0.4, 0.5, (16, 32, 3)).astype(np.float32)
    sky[4, k % 32] = 300
    sky[6, 20] = 40 + 20 * (k % 3)
    write_exr(path, sky)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    for k in range(FRAMES):
        write_frame(folder / f"sky_{k:04d}.exr", k)
    return folder


@pytest.fixture(scope="module")
def lights(recording, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What `vemlight lights` makes of it."""
    out = tmp_path_factory.mktemp("lights") / "lights.jsonl"
    write_lights_file(LightsOptions(source=recording, out=out))
    return out.read_bytes()


@pytest.fixture(scope="module")
def mapped(recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive's folder with all maps, made by two shares of the chunks, and no lights."""
    out = tmp_path_factory.mktemp("mapped") / "archive"
    for index in (1, 0):
        archive(ArchiveOptions(source=recording, out=out, chunk=6, workers=1, maps_only=True, index=index, indices=2))
    return out


def from_maps(mapped: Path, out: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(mapped, out))


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize(("workers", "chunk"), [(1, FRAMES), (2, 7), (2, 1)])
def test_the_bytes_are_those_of_lights_whatever_the_chunks_and_workers(recording, lights, tmp_path, workers, chunk):
    report = archive(ArchiveOptions(source=recording, out=tmp_path / "a", workers=workers, chunk=chunk))
    assert (tmp_path / "a" / "lights.jsonl").read_bytes() == lights
    assert names(tmp_path / "a") == {"plan.json", "lights.jsonl", "lights.sha256"}
    assert report.values["frames"] == FRAMES
    assert subprocess.run(["sha256sum", "--check", "--quiet", "lights.sha256"], cwd=tmp_path / "a", check=False).returncode == 0


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_a_state_on_disk_changes_no_byte(recording, tmp_path, method, monkeypatch):
    """Every chunk by a process of its own, as it were: each run ends behind one."""
    write_lights_file(LightsOptions(source=recording, out=tmp_path / "l.jsonl", **method))
    options = ArchiveOptions(source=recording, out=tmp_path / "a", chunk=6, from_maps=True, **method)
    archive(msgspec.structs.replace(options, from_maps=False, maps_only=True, workers=1))
    light = archiving._Archiving._light

    def one(self, chunk, maps):
        yield from light(self, chunk, maps)
        raise KeyboardInterrupt

    monkeypatch.setattr(archiving._Archiving, "_light", one)
    for done in range(1, 5):
        with pytest.raises(Interrupted, match=f"{done} of 4 chunks; the same command goes on"):
            archive(options)
    monkeypatch.undo()
    archive(options)
    assert (tmp_path / "a" / "lights.jsonl").read_bytes() == (tmp_path / "l.jsonl").read_bytes()


def started(recording: Path, out: Path) -> subprocess.Popen:
    command = [sys.executable, "-m", "vemlight", "archive", str(recording), "--out", str(out), "--chunk", "2", "--workers", "2"]
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)


def children(process: int) -> list[int]:
    return [int(text) for text in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def wait_for_state(folder: Path, chunk: int, process: subprocess.Popen) -> None:
    until_s = time.monotonic() + 60
    while not (folder / f"state_{chunk:06d}").exists() and process.poll() is None:
        assert time.monotonic() < until_s
        time.sleep(0.002)


def gone(processes: list[int]) -> bool:
    until_s = time.monotonic() + 10
    while any(Path(f"/proc/{one}").exists() and "Z" not in Path(f"/proc/{one}/stat").read_text().split()[2] for one in processes):
        if time.monotonic() > until_s:
            return False
        time.sleep(0.01)
    return True


def test_after_four_kills_the_bytes_are_the_same_and_no_worker_is_left(recording, lights, tmp_path):
    killed = 0
    for chunk in (0, 2, 3, 6):
        process = started(recording, tmp_path / "a")
        wait_for_state(tmp_path / "a", chunk, process)
        if process.poll() is None:
            own = children(process.pid)
            process.kill()
            killed += 1
            assert gone(own)
        process.communicate()
    assert killed >= 2  # the last may be done before they are killed
    again = started(recording, tmp_path / "a")
    _, said = again.communicate(timeout=60)
    assert again.returncode == 0, said
    assert (tmp_path / "a" / "lights.jsonl").read_bytes() == lights
    assert names(tmp_path / "a") == {"plan.json", "lights.jsonl", "lights.sha256"}


def test_ctrl_c_ends_with_130_and_the_same_command_goes_on(recording, lights, tmp_path):
    process = started(recording, tmp_path / "a")
    wait_for_state(tmp_path / "a", 0, process)
    own = children(process.pid)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in said
    assert "the same command goes on from there" in said
    assert gone(own)
    assert not [name for name in names(tmp_path / "a") if ".part" in name and not name.startswith("maps_")]
    archive(ArchiveOptions(source=recording, out=tmp_path / "a", workers=1))  # the chunks as they were begun
    assert (tmp_path / "a" / "lights.jsonl").read_bytes() == lights


def test_a_damaged_frame_is_named_and_what_came_before_it_stays(recording, lights, tmp_path):
    source, out = Path(shutil.copytree(recording, tmp_path / "r")), tmp_path / "a"
    (source / "sky_0013.exr").write_bytes((source / "sky_0013.exr").read_bytes()[:200])
    options = ArchiveOptions(source=source, out=out, chunk=5, workers=2)
    with pytest.raises(UserError, match=r"sky_0013\.exr.*keeps the 2 chunks before it"):
        archive(options)
    assert {"lights_000000.jsonl", "lights_000001.jsonl", "state_000001"} <= names(out)
    shutil.copyfile(recording / "sky_0013.exr", source / "sky_0013.exr")
    archive(options)
    assert (out / "lights.jsonl").read_bytes() == lights


def interrupted(options: ArchiveOptions, after: int, monkeypatch) -> None:
    """Makes the chunks before `after`."""
    with monkeypatch.context() as patched:
        light = archiving._Archiving._light

        def some(self, chunk, maps):
            if chunk == after:
                raise KeyboardInterrupt
            yield from light(self, chunk, maps)

        patched.setattr(archiving._Archiving, "_light", some)
        with pytest.raises(Interrupted):
            archive(options)


def test_frames_that_were_changed_since_are_refused(recording, mapped, tmp_path, monkeypatch):
    source = Path(shutil.copytree(recording, tmp_path / "r"))
    options = ArchiveOptions(source=source, out=tmp_path / "a", chunk=6, workers=1)
    interrupted(options, 2, monkeypatch)
    os.utime(source / "sky_0019.exr", (1, 1))  # of which no lights were made
    before = names(tmp_path / "a")
    os.utime(source / "sky_0007.exr", (1, 1))
    with pytest.raises(UserError, match="frames 6 to 11 were changed since their lights were made; choose another --out"):
        archive(options)
    assert names(tmp_path / "a") == before


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"count": 8}, r"\[sampler\] count is 8 and was None"),
        ({"chunk": 5}, "--chunk is 5 and was 6"),
        ({"frames": 10}, "the number of frames is 10 and was 20"),
        ({"ground": 0.2}, r"\[capture\] ground is 0.2 and was 0.0"),
    ],
)
def test_another_plan_is_refused_and_the_folder_stays(recording, mapped, given, said):
    before = {path.name: path.stat().st_mtime_ns for path in mapped.iterdir()}
    with pytest.raises(UserError, match=f"holds another archive: {said}; choose another --out"):
        archive(ArchiveOptions(source=recording, out=mapped, **{"from_maps": True, **given}))
    assert {path.name: path.stat().st_mtime_ns for path in mapped.iterdir()} == before


@pytest.mark.parametrize(
    ("changed", "said"),
    [({"version": "0.0.9"}, "vemlight is .* and was 0.0.9"), ({"names": 64 * "0"}, "the names of its frames have changed since"),
     ({"frames": FRAMES + 1}, f"the number of frames is {FRAMES} and was {FRAMES + 1}"),
     ({"calibration": {"lens.toml": 64 * "0"}}, "lens.toml has changed since")],
)  # fmt: skip
def test_a_worker_with_another_version_or_other_files_makes_no_maps(mapped, changed, said):
    plan = archiving.found_plan(mapped)
    assert plan
    file = BytesIO()
    fault = ChunkMaker(msgspec.structs.replace(plan, **changed)).to(0, file).fault
    assert re.search(f"on {os.uname().nodename} {said}; all workers need the same", fault)
    assert not file.getvalue()


def test_maps_of_other_files_than_are_here_give_no_lights(recording, mapped, tmp_path, monkeypatch):
    """As a Dask worker sends them that has a copy of its own, and as frames that change meanwhile give."""
    out = from_maps(mapped, tmp_path / "a")
    with open(out / "maps_000000", "rb") as file:
        reader = MapReader(file)
        content = BytesIO()
        write_maps(content, msgspec.structs.replace(reader.header, files=64 * "0"), reader.frames())
    monkeypatch.setattr(archiving._Archiving, "_chunks", lambda *_: iter([(0, content)]))
    with pytest.raises(UserError, match="the files of frames 0 to 5 have changed while their maps were made, or a worker has others"):
        archive(ArchiveOptions(source=recording, out=out, chunk=6))
    assert not [name for name in names(out) if name.startswith(("state", "lights"))]


def test_a_plan_is_kept_on_a_disk_without_links(mapped, tmp_path, monkeypatch):
    plan = archiving.found_plan(mapped)
    assert plan

    def refused(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refused)
    for _ in range(2):
        keep_plan(tmp_path, plan)
        assert names(tmp_path) == {"plan.json"}
        assert archiving.found_plan(tmp_path) == plan


def test_lights_that_are_gone_are_made_again(recording, lights, mapped, tmp_path, monkeypatch, capsys):
    out = from_maps(mapped, tmp_path / "a")
    interrupted(ArchiveOptions(source=recording, out=out, from_maps=True), 3, monkeypatch)
    assert {"state_000001", "state_000002"} == {name for name in names(out) if name.startswith("state")}
    (out / "lights_000001.jsonl").unlink()
    archive(ArchiveOptions(source=recording, out=out, workers=1))
    assert "lights_000001.jsonl: is gone or was changed; going on from the first frame" in capsys.readouterr().err
    assert (out / "lights.jsonl").read_bytes() == lights


def test_a_damaged_state_counts_as_none_and_the_one_before_it_goes_on(recording, lights, mapped, tmp_path, monkeypatch, capsys):
    out = from_maps(mapped, tmp_path / "a")
    interrupted(ArchiveOptions(source=recording, out=out, from_maps=True), 3, monkeypatch)
    (out / "state_000002").write_bytes(b"x")
    archive(ArchiveOptions(source=recording, out=out, workers=1))
    assert "going on from chunk 2 of 4" in capsys.readouterr().err
    assert (out / "lights.jsonl").read_bytes() == lights


def test_damaged_maps_are_removed_and_made_again(recording, lights, mapped, tmp_path):
    out = from_maps(mapped, tmp_path / "a")
    data = bytearray((out / "maps_000002").read_bytes())
    data[5000] ^= 1
    (out / "maps_000002").write_bytes(data)
    with pytest.raises(UserError, match="maps_000002: is damaged, and was removed; make it again by --maps-only"):
        archive(ArchiveOptions(source=recording, out=out, from_maps=True))
    with pytest.raises(UserError, match="maps_000002: is missing, or of other frames; run --maps-only first"):
        archive(ArchiveOptions(source=recording, out=out, from_maps=True))
    archive(ArchiveOptions(source=recording, out=out, workers=1))
    assert (out / "lights.jsonl").read_bytes() == lights


def test_a_name_that_is_not_utf_8_is_refused_for_the_source_and_kept_for_frames(recording, tmp_path):
    source = tmp_path / os.fsdecode(b"\xff")
    shutil.copytree(recording, source)
    with pytest.raises(UserError, match=r"udcff: is not UTF-8, and plan\.json holds nothing else"):
        archive(ArchiveOptions(source=source, out=tmp_path / "a", workers=1))
    assert not (tmp_path / "a").exists()
    frames = tmp_path / "frames"
    frames.mkdir()
    shutil.copyfile(recording / "sky_0000.exr", frames / os.fsdecode(b"\xff_0000.exr"))
    archive(ArchiveOptions(source=frames, out=tmp_path / "b", workers=1))
    assert (tmp_path / "b" / "lights.jsonl").exists()


def test_pipes_in_the_folder_are_waited_for_by_nobody(recording, lights, mapped, tmp_path):
    out = from_maps(mapped, tmp_path / "a")
    (out / "maps_000000").unlink()
    for name in ("maps_000000", "lights_000000.jsonl", "state_000003"):
        os.mkfifo(out / name)
    archive(ArchiveOptions(source=recording, out=out, chunk=6, workers=1))
    assert (out / "lights.jsonl").read_bytes() == lights


def test_two_archives_cannot_share_a_folder_and_two_makers_of_maps_can(recording, mapped, tmp_path):
    out = from_maps(mapped, tmp_path / "a")
    plan = archiving.found_plan(out)
    assert plan
    with archiving.claimed_archive(out, plan, shared=True):
        archive(ArchiveOptions(source=recording, out=out, maps_only=True))
        with pytest.raises(UserError, match="another archive writes there"):
            archive(ArchiveOptions(source=recording, out=out, from_maps=True))


def test_a_complete_archive_is_said_to_be_and_a_changed_one_refused(recording, mapped, tmp_path, capsys):
    options = ArchiveOptions(source=recording, out=from_maps(mapped, tmp_path / "a"), from_maps=True)
    archive(options)
    archive(options)
    assert "is complete; remove the folder to make it again" in capsys.readouterr().err
    (options.out / "lights.jsonl").write_bytes(b"")
    with pytest.raises(UserError, match="is gone or was changed since it was complete"):
        archive(options)


@pytest.mark.parametrize("said", ["echo ready; ", ""], ids=["ready", "while it loads"])
def test_a_worker_that_dies_is_replaced_and_three_over_one_chunk_are_enough(recording, lights, tmp_path, monkeypatch, said):
    script = tmp_path / "python"
    script.write_text(f'#!/bin/sh\nif mkdir "{tmp_path}/once"; then {said}kill -9 $$; fi\nexec {sys.executable} "$@"\n')
    script.chmod(0o755)
    monkeypatch.setattr(workers.sys, "executable", str(script))
    archive(ArchiveOptions(source=recording, out=tmp_path / "a", chunk=10, workers=1))
    assert (tmp_path / "a" / "lights.jsonl").read_bytes() == lights
    script.write_text(f"#!/bin/sh\n{said}kill -9 $$\n")
    with pytest.raises(FatalError, match=r"3 workers ended over chunk 0, the last one was killed by SIGKILL; more memory"):
        archive(ArchiveOptions(source=recording, out=tmp_path / "b", chunk=10, workers=1))


def test_a_worker_that_cannot_start_ends_the_archive_at_once(recording, tmp_path, monkeypatch):
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\nexit 1\n")
    script.chmod(0o755)
    monkeypatch.setattr(workers.sys, "executable", str(script))
    with pytest.raises(FatalError, match="a worker ended with status 1 before its first chunk"):
        archive(ArchiveOptions(source=recording, out=tmp_path / "a", chunk=10, workers=1))


def test_frames_of_another_size_are_refused_in_any_chunk(recording, tmp_path):
    """As `lights` refuses them, though no worker sees the first size before."""
    source = Path(shutil.copytree(recording, tmp_path / "r"))
    for k in range(10, 20):
        write_exr(source / f"sky_{k:04d}.exr", np.ones((8, 16, 3), np.float32))
    with pytest.raises(UserError) as by_lights:
        write_lights_file(LightsOptions(source=source, out=tmp_path / "l.jsonl"))
    with pytest.raises(UserError) as by_archive:
        archive(ArchiveOptions(source=source, out=tmp_path / "a", chunk=10, workers=2))
    assert str(by_archive.value).startswith(str(by_lights.value))


def test_the_command_line_says_what_it_did(recording, mapped, tmp_path):
    out = from_maps(mapped, tmp_path / "a")
    done = vemlight("archive", str(recording), "--out", str(out), "--from-maps", "--json")
    assert done.returncode == 0
    assert '"frames":20' in done.stdout
