"""The command line: what it writes, and bad input as status 2 and one line that says what, where and how to fix it."""

import json
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from typing import get_args

import click
import moderngl
import numpy as np
import pytest
from click.testing import CliRunner, Result

from tests.support.lights_files import light_set_from_row, read_lights
from tests.support.processes import vemlight
from vemlight.choices import Filter, Method
from vemlight.commands.capture_commands import calibrate
from vemlight.commands.cli import main
from vemlight.commands.options import LensOptions, LightsOptions, RenderOptions, ResponseOptions, SimulateOptions
from vemlight.light.images import write_exr
from vemlight.light.sphere import latlong_directions
from vemlight.renderer.output.video import chosen_encoder
from vemlight.settings import Capture, Renderer, Sampler
from vemlight.settings_file import OPTIONS

LENS = """
size = [32, 16]
f = [5.0, 5.0]
c = [15.5, 7.5]
k1 = 0.0
k2 = 0.0
k3 = 0.0
k4 = 0.0
rim_deg = 90.0
"""


def invoked(*arguments: object) -> Result:
    """The command in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def refused(done: Result, *words: str) -> None:
    assert done.exit_code == 2, done.output
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    for word in words:
        assert word in lines[0], lines[0]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    image = np.full((16, 32, 3), 0.5, np.float32)
    for k in range(3):
        write_exr(tmp_path / f"f_{k:04d}.exr", image)
    rows = "".join(f"{code},{luminance},fit\n" for code, luminance in ((190, 1), (160, 10), (90, 100), (60, 1000), (40, 5000)))
    (tmp_path / "falling.csv").write_text(f"code,luminance,use\n{rows}110,30,check\n")
    return tmp_path


def test_truncated_exr(folder):
    whole = (folder / "f_0001.exr").read_bytes()
    (folder / "f_0001.exr").write_bytes(whole[: len(whole) // 2])
    refused(invoked("lights", folder, "--out", folder / "l.jsonl"), "f_0001.exr", "truncated")
    assert not (folder / "l.jsonl").exists()


def test_gap_in_the_numbering(folder):
    (folder / "f_0001.exr").rename(folder / "f_0003.exr")
    done = invoked("lights", folder, "--out", folder / "l.jsonl")
    assert done.exit_code == 0
    assert "1 frame is missing after f_0000.exr" in done.stderr
    assert [row.time_s for row in read_lights(folder / "l.jsonl")] == [0.0, 2 / 25, 3 / 25]


def test_invalid_cells_are_counted(folder):
    write_exr(folder / "nan.exr", np.full((16, 32, 3), np.nan, np.float32))
    done = invoked("lights", folder / "nan.exr", "--count", 4, "--out", folder / "l.json")
    assert done.exit_code == 0
    assert "32400 of 32400 cells of the map were nan, infinite or negative, and count as dark" in done.stderr


def test_a_shape_that_is_no_latlong_map(folder):
    write_exr(folder / "square.exr", np.ones((16, 16, 3), np.float32))
    refused(invoked("lights", folder / "square.exr", "--out", folder / "l.json"), "square.exr", "16x16", "twice as wide", "lens.toml")


def test_a_layer_that_is_not_there(folder):
    refused(invoked("lights", folder / "f_0000.exr", "--layer", "diffuse", "--out", folder / "l.json"), "f_0000.exr", "no layer diffuse")


def test_lens_file_with_a_missing_key(folder):
    lens = folder / "lens_bad.toml"
    lens.write_text(LENS.replace("f = [5.0, 5.0]\n", ""))
    refused(invoked("polar", folder / "f_0000.exr", "--lens", lens, "--out", folder / "m.exr"), "lens_bad.toml", "no f;")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("colour = 3", ("colour",)),
        ("[sampler]\ncount = 0", ("count",)),
        ("[sampler]\nmethod = 'best'", ("method",)),
        ("[wire]\ntransport = 'tcp'", ("keys",)),
        ("mode = 'lossless'\n[capture]\nsource = '/dev/video0'", ("/dev/video0", "live")),
        ("[viewer\n", ("TOML",)),
        ("[capture]\nsource = 'nowhere'", ("nowhere",)),
    ],
)
def test_unusable_settings(text, words, tmp_path):
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    refused(invoked("capture", file), *words)


def test_scene_that_names_a_mesh_that_is_not_there(folder):
    scene = folder / "scene.toml"
    scene.write_text('[camera]\nfrom = [3.0, -4.0, 2.5]\nat = [0.0, 0.0, 0.6]\nfov_y = 40.0\n[[mesh]]\nfile = "ghost.obj"\n')
    done = invoked("render", folder / "f_0000.exr", "--scene", scene, "--size", "32x24", "--out", folder / "p.png")
    refused(done, "scene.toml", "ghost.obj")


def test_port_in_use(tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        (tmp_path / "sockets").mkdir(mode=0o700)
        (tmp_path / "v.toml").write_text(f"[viewer]\nport = {port}\n[wire]\nfolder = 'sockets'\n")
        refused(invoked("viewer", tmp_path / "v.toml"), str(port))


def test_no_gl(folder):
    nowhere = {"LIBGL_DRIVERS_PATH": "/none", "__EGL_VENDOR_LIBRARY_FILENAMES": "/none", "EGL_PLATFORM": "surfaceless"}
    done = vemlight("render", folder / "f_0000.exr", "--size", "32x24", "--out", folder / "p.png", environment=nowhere)
    (line,) = done.stderr.splitlines()
    assert done.returncode == 2
    assert line.startswith("vemlight: no OpenGL")
    assert "unset LIBGL_DRIVERS_PATH" in line


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("lights", "nothing.hdr", "--out", "l.json"), ("nothing.hdr",)),
        (("lights", "f_0000.exr", "--out", "l.txt"), ("l.txt", ".jsonl")),
        (("lights", ".", "--out", "l.json"), ("l.json", ".jsonl")),
        (("lights", "f_0000.exr", "--method", "best", "--out", "l.json"), ("--method", "havran-azimuth")),
        (("lights", "f_0000.exr", "--out", "no/folder/l.json"), ("no/folder",)),
        (("render", "f_0000.exr", "--size", "large", "--out", "p.png"), ("--size", "640x480")),
        (("render", "f_0000.exr", "--size", "9000x2", "--out", "p.png"), ("--size", "8192")),
        (("render", "f_0000.exr", "--size", "9" * 5000 + "x2", "--out", "p.png"), ("--size", "640x480")),
        (("render", "f_0000.exr", "--out", "no/folder/p.png"), ("no/folder",)),
        (("lights", "f_0000.exr", "--method", "standard", "--filter", "adaptive", "--out", "l.json"), ("vemlight: filter", "auto")),
        (("render", "f_0000.exr", "--out", "p.gif"), ("p.gif", ".png")),
        (("render", "f_0000.exr", "--size", "32x24"), ("--out", "--video")),
        (("render", "f_0000.exr", "--size", "32x24", "--video", "p.avi"), ("p.avi", ".mp4")),
        (("run", "absent.toml"), ("absent.toml",)),
        (("calibrate", "lens", "f_0000.exr", "--board", "8", "--square", "0.03", "--out", "l.toml"), ("--board", "8x6")),
        (("calibrate", "lens", "ghost.jpg", "--board", "8x6", "--square", "0.03", "--out", "l.toml"), ("ghost.jpg",)),
        (("calibrate", "response", "ghost.csv", "--out", "r.toml"), ("ghost.csv",)),
        (("calibrate", "response", "falling.csv", "--bits", "8", "--out", "r.toml"), ("rise",)),
        (("calibrate", "response", "f_0000.exr", "--corners", "1,2,3,4,5,6", "--white", "9", "--out", "r.toml"), ("--corners", "eight")),
        (("calibrate", "response", "f_0000.exr", "--corners", "1,2,3,4,5,6,7,8", "--out", "r.toml"), ("--white",)),
        (("calibrate", "response", "f_0000.exr", "--white", "9", "--out", "r.toml"), ("no ColorChecker", "corners")),
        (("record", "--source", "/dev/video9999", "--out", "recording"), ("/dev/video9999",)),
        (("simulate", "f_0000.exr", "--lens", "ghost.toml", "--out", "taken"), ("ghost.toml",)),
        (("health", "capture", "elsewhere.toml"), ("elsewhere.toml",)),
    ],
)
def test_unusable_arguments(arguments, words, folder, monkeypatch):
    monkeypatch.chdir(folder)
    refused(invoked(*arguments), *words)


def test_lights_of_one_lit_pixel_point_at_it(tmp_path):
    """The light's direction is right to a pixel's width, here 180 / 64 degrees."""
    image = np.zeros((64, 128, 3), np.float32)
    image[13, 90] = (3.0, 2.0, 1.0)
    write_exr(tmp_path / "spot.exr", image)
    done = invoked("lights", tmp_path / "spot.exr", "--count", 1, "--out", tmp_path / "l.json")
    assert done.exit_code == 0, done.stderr
    (row,) = read_lights(tmp_path / "l.json")
    lights = light_set_from_row(row)
    towards = latlong_directions(64, 128)[13, 90]
    assert np.degrees(np.arccos(np.clip(lights.directions[0] @ towards, -1, 1))) < 180 / 64


def test_a_context_that_is_lost_while_drawing_is_one_line(folder, monkeypatch):
    monkeypatch.setattr(moderngl.Context, "error", property(lambda _: "GL_CONTEXT_LOST"))
    source, out = str(folder / "f_0000.exr"), str(folder / "p.png")
    done = invoked("render", source, "--count", 4, "--size", "16x12", "--out", out)
    assert done.exit_code == 1
    assert done.stderr.startswith("vemlight: OpenGL stopped working (GL_CONTEXT_LOST, ")
    assert done.stderr.count("\n") == 1
    assert not (folder / "p.png").exists()


def test_a_command_says_what_it_has_written(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "camera.toml").write_text(LENS)
    drawn = ("--count", 8, "--fps", 25, "--size", "16x12", "--shadow-map", 16)
    encoder = chosen_encoder(".mp4", 16, 12).shown
    taken = "taken: the frames, their lens.toml, and the truth in truth.jsonl"
    for arguments, line in (
        (("lights", "f_0000.exr", "--count", 8, "--out", "l.json"), "l.json: 8 lights"),
        (("lights", ".", "--count", 8, "--fps", 25, "--out", "l.jsonl"), "l.jsonl: the lights of 3 frames"),
        (("render", "f_0000.exr", *drawn, "--out", "p.png"), "p.png"),
        (("render", ".", *drawn, "--out", "p.exr", "--video", "v.mp4"), f"p_0000.exr to p_0002.exr, v.mp4 as {encoder}"),
        (("simulate", "f_0000.exr", "--lens", "camera.toml", "--out", "taken"), taken),
    ):
        done = invoked(*arguments)
        assert (done.exit_code, done.stdout, done.stderr) == (0, f"{line}\n", "")


def test_a_report_comes_as_a_line_as_json_or_not_at_all(folder, monkeypatch):
    monkeypatch.chdir(folder)
    (folder / "camera.toml").write_text(LENS)
    made = {  # the map last: it would be one of the frames of "."
        ("lights", ".", "--count", 8, "--fps", 25, "--out", "l.jsonl"): {"out": "l.jsonl", "frames": 3, "lights": {"fewest": 8, "most": 8}},
        ("record", "--source", ".", "--out", "rec"): {"out": "rec", "written": 3, "dropped": 0, "failed": 0},
        ("polar", "f_0000.exr", "--lens", "camera.toml", "--out", "m.exr"): {
            "out": "m.exr", "coverage": "hemisphere", "rows": 90, "cols": 360, "black": 0, "saturated": 0,
        },
    }  # fmt: skip
    for arguments, values in made.items():
        shutil.rmtree(folder / "rec", ignore_errors=True)
        done = invoked(*arguments, "--json")
        assert (done.exit_code, done.stderr) == (0, "")
        assert json.loads(done.stdout) == values
        shutil.rmtree(folder / "rec", ignore_errors=True)
        done = invoked(*arguments, "--quiet")
        assert (done.exit_code, done.stdout, done.stderr) == (0, "", "")


def test_the_score_is_part_of_the_report(folder):
    done = invoked("lights", folder / "f_0000.exr", "--count", 8, "--score", "--json", "--out", folder / "l.json")
    assert 0 <= json.loads(done.stdout)["score"]["error"] < 0.2


def test_lights_and_maps_go_to_standard_output(folder, monkeypatch):
    """The same bytes as into a file, and nothing between them."""
    monkeypatch.chdir(folder)
    (folder / "camera.toml").write_text(LENS)
    lights = ("lights", ".", "--count", 8, "--fps", 25)
    polar = ("polar", "f_0000.exr", "--lens", "camera.toml")
    for arguments, name in ((lights, "l.jsonl"), (polar, "m.exr")):
        assert invoked(*arguments, "--out", name).exit_code == 0
        done = invoked(*arguments, "--out", "-")
        assert (done.exit_code, done.stdout_bytes) == (0, (folder / name).read_bytes())
        assert done.stderr.startswith("-: ")
        assert invoked(*arguments, "--out", "-", "--quiet").stderr == ""


def test_methods_and_filters_are_listed_and_completed():
    page = invoked("lights", "--help").stdout
    assert f"[{'|'.join(get_args(Method))}]" in page
    assert f"[{'|'.join(get_args(Filter))}]" in page
    words = {"_VEMLIGHT_COMPLETE": "bash_complete", "COMP_WORDS": "vemlight lights --method ", "COMP_CWORD": "3"}
    done = CliRunner().invoke(main, [], prog_name="vemlight", env=words)
    assert done.stdout.split() == [f"plain,{method}" for method in get_args(Method)]


def test_a_recording_plays_back_the_same_and_lights_are_scored(folder, monkeypatch):
    monkeypatch.chdir(folder)
    done = invoked("record", "--source", ".", "--out", "recording")
    assert done.exit_code == 0, done.stderr
    assert "3 frames" in done.stdout, done.output
    for source, out in ((".", "a.jsonl"), ("recording", "b.jsonl")):
        done = invoked("lights", source, "--count", 8, "--fps", 25, "--score", "--out", out)
        assert done.exit_code == 0, done.stderr
        assert "error" in done.stdout
        assert "flicker" in done.stdout
    assert [light_set_from_row(row).directions.tolist() for row in read_lights(folder / "a.jsonl")] == [
        light_set_from_row(row).directions.tolist() for row in read_lights(folder / "b.jsonl")
    ]


@pytest.mark.parametrize("method", ["tracked", "havran-azimuth"])
def test_mains_flicker_is_removed_from_a_recording_unless_refused(method, tmp_path):
    """Lamps of 100 Hz at 21 frames a second, with 64 frames for them to be known; the total power then stands still."""
    (tmp_path / "in").mkdir()
    for k in range(80):
        write_exr(tmp_path / "in" / f"f_{k:04d}.exr", np.full((16, 32, 3), 1 + 0.3 * np.sin(200 * np.pi * k / 21), np.float32))
    swing = {}
    for options in (["--no-deflicker"], []):
        common = ("--method", method, "--filter", "none", "--count", 8, "--fps", 21, "--out", tmp_path / "l.jsonl")
        done = invoked("lights", tmp_path / "in", *common, *options)
        assert done.exit_code == 0, done.stderr
        power = [light_set_from_row(row).irradiance.sum() for row in read_lights(tmp_path / "l.jsonl")[64:]]
        swing[len(options)] = np.ptp(power) / np.mean(power)
    assert swing[1] > 0.5
    assert swing[0] < 0.02


@pytest.mark.parametrize(("command", "kind"), [
    (main.commands["lights"], LightsOptions),
    (main.commands["render"], RenderOptions),
    (main.commands["simulate"], SimulateOptions),
    (calibrate.commands["lens"], LensOptions),
    (calibrate.commands["response"], ResponseOptions),
])  # fmt: skip
def test_the_options_of_a_command_are_the_fields_of_its_record(command, kind):
    of_the_report = {"help", "as_json", "quiet"}
    made_of_others = {"given"}  # which of the options were typed
    assert {parameter.name for parameter in command.params} - of_the_report == set(kind.__struct_fields__) - made_of_others


def test_options_are_called_in_errors_as_they_are_typed():
    keys = {key for kind in (Capture, Sampler, Renderer) for key in kind.__struct_fields__}
    for command in ("lights", "render"):
        for option in main.commands[command].params:
            if isinstance(option, click.Option) and option.name in keys:
                assert OPTIONS.get(option.name, f"--{option.name.replace('_', '-')}") in option.opts


def test_help_loads_neither_numba_nor_cv2():
    loaded = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "vemlight", "--help"], capture_output=True, text=True, timeout=60
    )
    assert "Usage" in loaded.stdout
    assert not {"numba", "cv2", "numpy", "moderngl"} & {line.rsplit("|", 1)[-1].strip() for line in loaded.stderr.splitlines()}


def test_masks_of_a_settings_file_leave_light_out(folder):
    (folder / "masks.toml").write_text('[[capture.masks]]\nmode = "dark"\npoints = [[0.0, 90.0]]\nwidth_deg = 60.0\n')
    totals = []
    for more in ([], ["--masks", folder / "masks.toml"]):
        done = invoked("lights", folder / "f_0000.exr", "--out", folder / "lights.json", *more)
        assert done.exit_code == 0, done.output
        totals.append(light_set_from_row(read_lights(folder / "lights.json")[0]).irradiance[:, 0].sum())
    assert totals[1] / totals[0] == pytest.approx(np.cos(np.radians(30)), rel=5e-3)  # a cap of 30 degrees has 1 - cos 30 of it
