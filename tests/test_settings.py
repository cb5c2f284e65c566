"""Settings: what is left out has a default, what is wrong is one line that names it."""

import re
from pathlib import Path
from typing import get_args, get_type_hints

import msgspec
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from vemlight.commands.settings_reference import settings_reference
from vemlight.errors import UserError
from vemlight.setting_keys import PATH
from vemlight.settings import Capture, Renderer, Sampler, Settings
from vemlight.settings_file import check_settings, read_settings, section_from_options
from vemlight.source_names import is_camera

SECTIONS = {name: kind for name, kind in get_type_hints(Settings).items() if isinstance(kind, type) and issubclass(kind, msgspec.Struct)}
HINTS = {name: get_type_hints(kind, include_extras=True) for name, kind in SECTIONS.items()}
ROOT = Path(__file__).parents[1]
KEYS = [(section, key) for section, kind in SECTIONS.items() for key in get_type_hints(kind)]
TEXTS = ("0", "1", "-1", "2.5", "nan", "inf", "1e400", '""', '"x"', "true", "[]", '["a"]', "{}", "{a = 1}", "9" * 30, "1979-05-27")
VALUES = st.sampled_from(TEXTS)


def written(folder, text):
    path = folder / "vemlight.toml"
    path.write_text(text)
    return path


def test_no_file_and_an_empty_file_are_the_defaults(tmp_path):
    assert read_settings(None) == read_settings(written(tmp_path, "")) == Settings()


def test_paths_are_relative_to_the_file_but_devices_are_not(tmp_path):
    text = 'out = "o"\n[capture]\nsource = "a"\n[renderer]\nscene = "s/b.toml"\n[plate]\nsource = "/dev/video1"\n[wire]\nfolder = "/run/v"'
    found = read_settings(written(tmp_path, text))
    assert (found.out, found.capture.source) == (str(tmp_path / "o"), str(tmp_path / "a"))
    assert (found.renderer.scene, found.plate.source, found.wire.folder) == (str(tmp_path / "s" / "b.toml"), "/dev/video1", "/run/v")
    assert found.capture.lens == ""


@pytest.mark.parametrize(
    ("source", "camera"),
    [("/dev/video0", True), ("/dev/v4l/by-id/usb-camera", True), ("/dev/shm/evening", False), ("/data/dev/video0", False), ("", False)],
)
def test_a_source_is_a_camera_by_its_path(source, camera):
    assert is_camera(source) == camera


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[sampler]\ncuont = 3", ("cuont",)),
        ("[sampler]\ncount = 0", ("count", "1")),
        ('[sampler]\nmethod = "standard"\nfilter = "adaptive"', ("filter adaptive", "standard")),
        ("[renderer]\nwidth = 8193", ("width", "8192")),
        ("[wire]\ntransport = \"tcp\"", ("keys", "insecure")),
        ('mode = "lossless"\n[capture]\nsource = "/dev/video0"', ("/dev/video0", "live")),
        ('[viewer]\ntoken = "0123456789abcdef"\ninsecure = true', ("token and insecure",)),
        ("[sampler", ("TOML",)),
        ("\x00", ("TOML",)),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path, text, words):
    with pytest.raises(UserError) as caught:
        read_settings(written(tmp_path, text))
    line = str(caught.value)
    assert "\n" not in line
    assert all(word in line for word in ("vemlight.toml", *words))


@given(st.lists(st.tuples(st.sampled_from(KEYS), VALUES), min_size=1, max_size=3))
@hypothesis_settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_value_anywhere_is_taken_or_refused_in_one_line(tmp_path, chosen):
    text = "".join(f"[{section}]\n{key} = {value}\n" for (section, key), value in chosen)
    message = "accepted"
    try:
        check_settings(read_settings(written(tmp_path, text)))
    except UserError as error:
        message = str(error)
    assert len(message.splitlines()) == 1


def test_the_page_of_all_settings_is_current_and_complete():
    """Each default and limit is written there: whoever changes one changes the page, by `make settings-doc`."""
    page = settings_reference()
    assert page == (ROOT / "docs" / "settings.md").read_text()
    for _, key in KEYS:
        assert re.search(rf"^\| `{key}` \|.*\| [^|]+ \|$", page, re.MULTILINE), f"{key} has no meaning there"


def test_every_key_that_names_a_file_is_relative_to_the_settings(tmp_path):
    keys = [(section, key) for section, hints in HINTS.items() for key, hint in hints.items() if PATH in get_args(hint)]
    assert set(keys) == {
        ("wire", "folder"), ("wire", "keys"), ("capture", "source"), ("capture", "lens"), ("capture", "response"), ("capture", "record"),
        ("capture", "recordings"),
        ("renderer", "scene"), ("renderer", "video"), ("plate", "source"), ("fixtures", "rig"), ("rig", "file"),
    }  # fmt: skip
    for section, key in keys:
        found = read_settings(written(tmp_path, f'[{section}]\n{key} = "a/b"\n'))
        assert getattr(getattr(found, section), key) == str(tmp_path / "a" / "b")


def test_the_services_that_run():
    assert "plate" not in Settings().services
    assert "plate" in msgspec.structs.replace(Settings(), plate=msgspec.convert({"source": "film.mp4"}, SECTIONS["plate"])).services


@pytest.mark.parametrize(("picture", "width", "fits"), [("srgb8", 4096, True), ("srgb8", 4097, False), ("linear16", 2049, False)])
def test_a_picture_that_no_message_holds_is_refused(picture, width, fits):
    wanted = Settings(renderer=Renderer(width=width, height=4096, picture=picture))
    if fits:
        check_settings(wanted)
    else:
        with pytest.raises(UserError, match=r"\[renderer\] width, height: .* make them smaller"):
            check_settings(wanted)


def test_options_of_a_command_line_are_named_as_there():
    assert section_from_options(Sampler, {"count": 5, "method": None}) == Sampler(count=5)
    for kind, values, words in (
        (Sampler, {"method": "best"}, ("--method", "tracked", "standard")),
        (Capture, {"fps": -1.0}, ("--fps",)),
        (Renderer, {"shadow_map": 1}, ("--shadow-map", "16")),
        (Sampler, {"error_percent": 200.0}, ("--error:", "100")),
        (Sampler, {"method": "tracked", "filter": "fir"}, ("filter fir", "filter auto")),
        (Sampler, {"method": "standard", "filter": "fir", "pass_hz": 9.0, "stop_hz": 7.0}, ("pass_hz below stop_hz",)),
        (Sampler, {"soft": True, "method": "standard"}, ("soft", "method tracked, not standard")),
    ):
        with pytest.raises(UserError) as caught:
            section_from_options(kind, values)
        assert all(word in str(caught.value) for word in words)


def test_what_the_settings_leave_out():
    assert (Sampler().max_count, Sampler().error_limit) == (256, 0.05)
    assert (Sampler(soft=True).max_count, Sampler(soft=True).error_limit) == (256, 0.05)
    assert (Sampler(soft=True, count=40).max_count, Sampler(soft=True, count=40).error_limit) == (40, 0.0)
    assert (Sampler(error_percent=7.0).max_count, Sampler(error_percent=7.0, count=9).max_count) == (256, 9)
    assert (Sampler(soft=True, error_percent=0.0).max_count, Sampler(soft=True, error_percent=0.0).error_limit) == (72, 0.0)


def test_soft_lights_and_their_adapted_number_are_the_default_together():
    assert (Sampler().is_soft, Sampler().error_limit, Sampler().max_count) == (True, 0.05, 256)
    assert (Sampler(count=9).is_soft, Sampler(count=9).error_limit) == (True, 0.0)
    assert (Sampler(soft=False).is_soft, Sampler(soft=False).max_count) == (False, 72)
    assert (Sampler(method="standard").is_soft, Sampler(method="standard").error_limit) == (False, 0.0)
