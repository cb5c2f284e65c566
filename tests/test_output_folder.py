"""The folder of a run: whose it is, what of it counts, and what the same command does with it."""

import os
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.light_sets import lights_from
from tests.support.settings_files import with_section
from vemlight.errors import UserError
from vemlight.light.light_set import LightsFile
from vemlight.renderer.output.image_sequence import ImageSequenceWriter
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.runtime import stamps
from vemlight.runtime.output_folder import claimed_output, is_complete
from vemlight.runtime.run_inputs import input_digests
from vemlight.settings import Capture, Renderer, Settings

PICTURES = 3


@pytest.fixture
def wanted(tmp_path) -> Settings:
    """The settings of a run that was cut off after three pictures."""
    source = tmp_path / "source"
    source.mkdir()
    (source / "a.exr").write_text("a")
    settings = Settings(mode="lossless", out=str(tmp_path / "out"), capture=Capture(source=str(source)), renderer=Renderer(width=8))
    with claimed_output(settings, overwrite=False) as complete:
        assert not complete
    lights, writer = LightsFile(tmp_path / "out" / "lights.jsonl", True), ImageSequenceWriter(settings)
    for k in range(PICTURES):
        lights.append(lights_from([0, 0, 1]), k, k / 25, "hemisphere")
        writer.add(np.zeros((6, 8, 4), np.float32), np.zeros((6, 8, 4), np.uint8), stamps.stamp(k, k / 25), Adaptation())
    lights.close()
    writer.close()
    return settings


def content(settings: Settings) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in Path(settings.out).iterdir()}


def kept(settings: Settings) -> int:
    """How many pictures the same command keeps."""
    with claimed_output(settings, overwrite=False):
        pass
    writer = ImageSequenceWriter(settings)
    writer.close()
    return writer.count


def test_the_same_command_keeps_everything_and_says_so(wanted, capsys):
    before = content(wanted)
    assert kept(wanted) == PICTURES
    assert content(wanted) == before
    assert "going on from picture 3" in capsys.readouterr().err


def test_what_changes_no_byte_may_differ(wanted):
    assert kept(with_section(with_section(wanted, "viewer", port=9000), "wire", folder="/run")) == PICTURES


@pytest.mark.parametrize(
    ("section", "change", "said"),
    [
        ("renderer", {"width": 16}, r"\[renderer\] width is 16 and was 8"),
        ("renderer", {"width": 640}, r"\[renderer\] width is 640 and was 8"),
        ("capture", {"frames": 7}, r"\[capture\] frames is 7 and was 0"),
    ],
)
def test_other_settings_are_refused_and_nothing_is_lost(wanted, section, change, said):
    before = content(wanted)
    other = with_section(wanted, section, **change)
    with pytest.raises(UserError, match=f"another run: {said}; .*--overwrite"), claimed_output(other, overwrite=False):
        pass
    with pytest.raises(UserError, match=said):
        ImageSequenceWriter(other)
    assert content(wanted) == before


def test_another_source_is_refused(wanted):
    (Path(wanted.capture.source) / "b.exr").write_text("b")
    with pytest.raises(UserError, match=r"the files of \[capture\] source have changed since"), claimed_output(wanted, False):
        pass


def test_overwriting_removes_what_runs_write_and_nothing_else(wanted):
    mine = Path(wanted.out) / "notes.txt"
    mine.write_text("mine")
    with claimed_output(with_section(wanted, "renderer", width=16), overwrite=True):
        assert content(wanted).keys() == {"notes.txt", "manifest.jsonl", "lights.jsonl"}
        assert (Path(wanted.out) / "lights.jsonl").read_bytes() == b""


@pytest.mark.parametrize(("name", "keeps"), [("frame_0002.exr", 2), ("frame_0000.png", 0)])
def test_a_picture_that_is_gone_is_made_again_with_all_that_follow(wanted, name, keeps):
    (Path(wanted.out) / name).unlink()
    assert kept(wanted) == keeps


def test_a_changed_picture_long_ago_is_found_when_the_command_is_given_again(wanted, monkeypatch):
    monkeypatch.setattr("vemlight.runtime.output_folder.NEWEST", 1)
    (Path(wanted.out) / "frame_0000.png").write_text("else")
    assert kept(wanted) == 0


def test_pictures_of_somebody_else_are_left_alone(tmp_path):
    (tmp_path / "frame_0001.exr").write_text("mine")
    with pytest.raises(UserError, match=r"has frame_0001\.exr without manifest\.jsonl"), claimed_output(Settings(out=str(tmp_path)), False):
        pass
    assert os.listdir(tmp_path) == ["frame_0001.exr"]


def test_a_complete_run_is_not_made_again(wanted, capsys):
    writer = ImageSequenceWriter(wanted)
    (Path(wanted.out) / "sampler.snapshot").write_text("")
    writer.complete()
    writer.close()
    assert is_complete(Path(wanted.out))
    assert "sampler.snapshot" not in content(wanted)
    with claimed_output(wanted, overwrite=False) as complete:
        assert complete
    assert "is complete: 3 pictures" in capsys.readouterr().err


def test_a_live_run_is_not_continued(tmp_path):
    live = Settings(out=str(tmp_path))
    with claimed_output(live, overwrite=False):
        writer = ImageSequenceWriter(live)
        writer.add(np.zeros((6, 8, 4), np.float32), np.zeros((6, 8, 4), np.uint8), stamps.stamp(0, 0.0), Adaptation())
        writer.close()
    with pytest.raises(UserError, match="a live run, which cannot be continued"), claimed_output(live, False):
        pass


def test_two_runs_do_not_share_a_folder(wanted):
    with claimed_output(wanted, False), pytest.raises(UserError, match="another run writes there"), claimed_output(wanted, False):
        pass


def test_files_that_a_scene_names_belong_to_its_inputs(tmp_path):
    (tmp_path / "scene.toml").write_text('[[mesh]]\nfile = "m/a.gltf"\n[[mesh]]\nfile = "b.obj"\nname = "no file"\n')
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "a.gltf").write_text('{"buffers": [{"uri": "a.bin"}, {"uri": "a.gltf"}], "images": [{"uri": "data:x"}]}')
    (tmp_path / "b.obj").write_text("mtllib b.mtl\nv 0 0 0\n")
    (tmp_path / "b.mtl").write_text("newmtl x\nmap_Kd -s 1 1 1 wood.png\n")
    settings = Settings(renderer=Renderer(scene=str(tmp_path / "scene.toml")))
    for name in ("scene.toml", "m/a.gltf", "m/a.bin", "b.obj", "b.mtl", "wood.png"):
        path = tmp_path / name
        path.touch()
        before = input_digests(settings)
        assert before == input_digests(settings)
        os.utime(path, ns=(1, 1))
        assert input_digests(settings) != before, name


def test_a_manifest_begins_with_the_settings_that_the_output_follows_from(wanted):
    start = msgspec.json.decode((Path(wanted.out) / "manifest.jsonl").read_bytes().splitlines()[0])
    assert start["settings"]["renderer"] == {"width": 8}
    assert not start["settings"].keys() & {"viewer", "wire", "out"}
