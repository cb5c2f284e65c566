"""Films to polar maps: colours in closed form through curves, codecs and tags; start, end and speed; one line for what is not right."""

import numpy as np
import pytest

from tests.support.films import Film, lamp_room, write_film
from vemlight.capture.polar import latlong_to_polar, polar_from_latlong
from vemlight.capture.source import open_files, open_source
from vemlight.errors import UserError
from vemlight.light.sphere import map_irradiance
from vemlight.settings import Capture

HEIGHT = 256
X265 = {"x265-params": "lossless=1:bframes=0:log-level=none"}
LENS = "size = [256, 256]\nf = [81.0, 81.0]\nc = [127.5, 127.5]\nk1 = 0.0\nk2 = 0.0\nk3 = 0.0\nk4 = 0.0\nrim_deg = 90.0\n"


def room(power):
    """Lamps and a noise of a tenth, so that the rounding of codes evens out over the map."""
    noise = np.random.default_rng(7).uniform(0.9, 1.1, (HEIGHT // 2, HEIGHT, 1)).repeat(2, axis=0).repeat(2, axis=1)
    return lamp_room(HEIGHT, power) * noise


def irradiance(picture):
    weights = latlong_to_polar(HEIGHT, 2 * HEIGHT, 90, 360, "hemisphere")
    return map_irradiance(polar_from_latlong(picture.astype(np.float32), weights), "hemisphere")


def frame_of(path, film, power, **settings):
    write_film(path, [room(power)], film)
    return open_files(Capture(source=str(path), **settings)).frame(0)


LOG = {"tagged": ("matrix", "range"), "pixels": "yuv444p12le"}
FILMS = [
    ("bt709 10 bits", Film(), 0.9, {}, 0.01),
    ("srgb full", Film("srgb", range="full", pixels="yuv444p"), 0.9, {}, 0.02),
    ("8 bits 4:2:0", Film(pixels="yuv420p", codec="libx264", options={"qp": "0"}), 0.9, {}, 0.025),
    ("rgb", Film("srgb", matrix="rgb", range="full", pixels="gbrp10le"), 0.9, {}, 0.02),
    ("pq 4:4:4", Film("pq", "bt2020", "bt2020"), 1000, {}, 0.01),
    ("pq 4:2:0 hevc", Film("pq", "bt2020", "bt2020", pixels="yuv420p10le", codec="libx265", options=X265), 1000, {}, 0.025),
    ("hlg", Film("hlg", "bt2020", "bt2020"), 0.9, {}, 0.01),
    ("p3", Film("srgb", "p3d65"), 0.9, {}, 0.01),
    ("no tags", Film("pq", "bt2020", "bt2020", tagged=()), 1000,
     {"transfer": "pq", "primaries": "bt2020", "matrix": "bt2020", "range": "limited"}, 0.01),
    ("wrong tags", Film("linear", "bt709", "bt709", pixels="yuv444p12le", tagged=()), 0.9, {"transfer": "linear"}, 0.01),
    ("logc3", Film("logc3", "awg3", **LOG), 20, {"transfer": "logc3"}, 0.01),
    ("logc4", Film("logc4", "awg4", **LOG), 50, {"transfer": "logc4"}, 0.01),
    ("slog3", Film("slog3", "sgamut3", **LOG), 5, {"transfer": "slog3"}, 0.01),
    ("vlog", Film("vlog", "vgamut", **LOG), 20, {"transfer": "vlog"}, 0.01),
    ("acescct", Film("acescct", "ap1", matrix="rgb", pixels="gbrp12le", tagged=()), 20, {"transfer": "acescct"}, 0.01),
]  # fmt: skip


@pytest.mark.parametrize(("film", "power", "settings", "tolerance"), [row[1:] for row in FILMS], ids=[row[0] for row in FILMS])
def test_the_colours_of_a_film(tmp_path, film, power, settings, tolerance):
    if "gbr" in film.pixels and film.range == "limited":
        settings = {**settings, "range": "limited"}
    frame = frame_of(tmp_path / ("f.mp4" if film.codec.startswith("lib") else "f.mkv"), film, power, **settings)
    np.testing.assert_allclose(map_irradiance(frame.radiance, "hemisphere"), irradiance(room(power)), rtol=tolerance)
    assert frame.luminance_scale == (1.0 if film.transfer == "pq" else None)
    assert frame.radiance.min() >= 0


@pytest.mark.parametrize(
    ("settings", "darker"), [({"range": "full"}, 0.95), ({"transfer": "hlg", "light": "display"}, 0.9), ({"primaries": "bt709"}, None)]
)
def test_what_is_read_wrongly_differs(tmp_path, settings, darker):
    """The reason for tags: each of them changes the light by more than the films above may miss."""
    film = Film("pq", "bt2020", "bt2020")
    right, wrong = (frame_of(tmp_path / f"{n}.mkv", film, 1000, **which).radiance for n, which in enumerate(({}, settings)))
    ratio = map_irradiance(wrong, "hemisphere") / map_irradiance(right, "hemisphere")
    assert np.abs(ratio - 1).max() > 0.03
    if darker:
        assert ratio.mean() < darker


def test_numbers_times_and_speed(tmp_path):
    write_film(tmp_path / "f.mkv", [room(0.1 + 0.08 * k) for k in range(6)], Film(), fps=10)
    source = open_source(Capture(source=str(tmp_path / "f.mkv"), start=1, end=5, speed=2.0))
    assert (len(source), source.fps) == (4, 20.0)
    frames = [source.frame(k) for k in (3, 0, 1, 2)]
    assert [frame.time_s for frame in frames] == [pytest.approx(0.15), 0, pytest.approx(0.05), pytest.approx(0.1)]
    power = [map_irradiance(frame.radiance, "hemisphere")[1] for frame in frames]
    np.testing.assert_allclose(power, [irradiance(room(0.1 + 0.08 * k))[1] for k in (4, 1, 2, 3)], rtol=0.01)
    np.testing.assert_array_equal(source.frame(3).radiance, frames[0].radiance)


def test_white_is_counted(tmp_path):
    picture = np.full((HEIGHT, 2 * HEIGHT, 3), 0.5)
    picture[10:12, 20:24] = 1.0
    picture[-1] = 1.0  # below the hemisphere's horizon
    write_film(tmp_path / "f.mkv", [picture], Film())
    assert open_files(Capture(source=str(tmp_path / "f.mkv"))).frame(0).saturated == 3 * 8


@pytest.mark.parametrize(("stereo", "said"), [("top_bottom", None), (None, "top-bottom"), ("left_right", None), (None, "side-by-side")])
def test_the_first_eye_of_two(tmp_path, capsys, stereo, said):
    first, second = room(0.8), room(0.1)
    picture = np.concatenate([first, second], axis=0 if "top" in str((stereo, said)) else 1)
    write_film(tmp_path / "f.mkv", [picture], Film(), metadata={"stereo_mode": stereo} if stereo else None)
    frame = open_files(Capture(source=str(tmp_path / "f.mkv"), stereo=said)).frame(0)
    np.testing.assert_allclose(map_irradiance(frame.radiance, "hemisphere"), irradiance(first), rtol=0.01)
    assert "two eyes" in capsys.readouterr().err


@pytest.mark.parametrize(("shape", "settings", "words"), [
    ((256, 256), {}, ["256x256", "twice as wide", "--projection equirect"]),
    ((256, 384), {"projection": "equirect"}, None),
    ((256, 256), {"span": (180.0, 180.0)}, None),
    ((256, 384), {"projection": "cube3x2"}, None),
    ((256, 256), {"projection": "cube3x2"}, ["256x256", "three square faces by two"]),
    ((256, 256), {"projection": "fisheye"}, ["--projection fisheye", "lens.toml"]),
    ((256, 384), {"lens": "lens.toml"}, ["384x256", "256x256", "lens file"]),
    ((256, 256), {"lens": "lens.toml"}, None),
    ((256, 256), {"lens": ("lens.toml", "other.toml")}, ["other.toml", "512x256", "256x256"]),
    ((256, 512), {"transfer": "ocio:nothing like it"}, ["ocio:nothing like it"]),
    ((256, 512), {"start": 3}, ["frames 0 to 0"]),
])  # fmt: skip
def test_shapes_and_projections(tmp_path, shape, settings, words):
    (tmp_path / "folder").mkdir()
    (tmp_path / "lens.toml").write_text(LENS)
    (tmp_path / "other.toml").write_text(LENS.replace("[256, 256]", "[512, 256]"))
    if lens := settings.get("lens"):
        settings = {**settings, "lens": str(tmp_path / lens) if isinstance(lens, str) else tuple(str(tmp_path / each) for each in lens)}
    write_film(tmp_path / "folder" / "f.mkv", [np.full((*shape, 3), 0.5)], Film())
    capture = Capture(source=str(tmp_path / "folder" / "f.mkv"), **settings)
    if words is None:
        assert open_files(capture).frame(0).radiance.max() == pytest.approx(0.5, rel=0.05)
        return
    with pytest.raises(UserError) as error:
        open_files(capture).frame(0)
    assert all(word in str(error.value) for word in words)


def test_settings_that_do_not_go_together():
    for settings, words in [
        ({"lens": "a.toml", "projection": "equirect"}, "lens is for fisheye"), ({"lens": "a.toml", "span": (180.0, 90.0)}, "span is for"),
        ({"projection": "cube3x2", "span": (180.0, 90.0)}, "span is for"), ({"lens": ("a", "b"), "stereo": "top-bottom"}, "stereo is of"),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=words):
            Capture(**settings)
