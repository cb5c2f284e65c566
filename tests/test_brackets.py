"""Folders of bracketed photographs: the light that was there, whatever the file, the order and the rounding of shutter times."""

import json

import numpy as np
import pytest
from PIL.TiffImagePlugin import IFDRational

from tests.support.photographs import dng, write_photograph
from vemlight.capture.exposure_groups import Photograph, exposure_groups
from vemlight.capture.ground import horizontal_irradiance
from vemlight.capture.lens import read_lens
from vemlight.capture.response import Linear, Log, Srgb, code_from_radiance, write_response
from vemlight.capture.source import open_files
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb, srgb_from_linear
from vemlight.light.images import write_exr
from vemlight.light.sphere import cell_solid_angles, map_irradiance
from vemlight.settings import Capture

SIZE = 96
LENS = f"size = [{SIZE}, {SIZE}]\nf = [30.0, 30.0]\nc = [47.5, 47.5]\nk1 = 0.0\nk2 = 0.0\nk3 = 0.0\nk4 = 0.0\nrim_deg = 90.0\n"
EXPOSURES = (1.0, 1 / 32, 1 / 1024)  # s
ELECTRONS = 15_000


def scene():
    """Four decades of sky and ground, and a sun of 8 pixels, 2e2 times the brightest of it, (SIZE, SIZE, 3)."""
    y, x = np.mgrid[:SIZE, :SIZE]
    light = 10.0 ** (3.4 * x / SIZE - 3)[..., None] * np.array([0.8, 1.0, 1.3])
    sun = np.exp(-((x - 60.3) ** 2 + (y - 40.7) ** 2) / (2 * 1.2**2))
    return light + 600 * sun[..., None] * np.array([1.0, 0.9, 0.7])


def exposed(light, exposure_s, rng):
    """The signal, 0 to 1, of light by a sensor with shot and read noise."""
    electrons = rng.poisson(np.minimum(light * exposure_s, 8) * ELECTRONS) + rng.normal(0, 3, light.shape)
    return np.clip(electrons / ELECTRONS, 0, 1)


def codes_of(signal, kind):
    if kind.startswith("linear"):
        return np.rint(signal * 65535).astype(np.uint16)
    return np.rint(srgb_from_linear(signal) * 255).astype(np.uint8)


def shots(folder, kind="linear.png", exposures=EXPOSURES, light=None, told=None, order=None, **tags):
    """Writes a bracket of the scene, or of `light`; told: the exposure times in the files, if they differ."""
    rng = np.random.default_rng(7)
    folder.mkdir(exist_ok=True)
    (folder / "lens.toml").write_text(LENS)
    for k in order or range(len(exposures)):
        codes = codes_of(exposed(scene() if light is None else light, exposures[k], rng), kind)
        at = (order or list(range(len(exposures)))).index(k)
        write_photograph(folder / f"shot_{at:03d}.{kind.split('.')[1]}", codes, (told or exposures)[k], **tags)
    return folder


def frame_of(folder, k=0, **settings):
    return open_files(Capture(source=str(folder), brackets=True, **settings)).frame(k)


def truth(tmp_path, light=None):
    write_exr(tmp_path / "truth.exr", (scene() if light is None else light).astype(np.float32), {"vemlight:kind": "fisheye"})
    (tmp_path / "lens.toml").write_text(LENS)
    return open_files(Capture(source=str(tmp_path / "truth.exr"))).frame(0)


def irradiance(frame):
    return map_irradiance(frame.radiance, "hemisphere")


@pytest.mark.parametrize(("kind", "transfer", "tolerance"), [
    ("linear.png", "linear", 0.01), ("srgb.png", "srgb", 0.01), ("srgb.jpg", "srgb", 0.025), ("srgb.tif", "srgb", 0.01),
])  # fmt: skip
@pytest.mark.parametrize("order", [None, [1, 2, 0]])
def test_a_bracket_is_the_light_that_was_there(tmp_path, kind, transfer, tolerance, order):
    got, true = frame_of(shots(tmp_path / "s", kind, order=order), transfer=transfer), truth(tmp_path)
    np.testing.assert_allclose(irradiance(got), irradiance(true), rtol=tolerance)
    dark = true.radiance[..., 1] < 0.02  # three decades below what the shortest exposure sees
    np.testing.assert_allclose(got.radiance[dark].sum(axis=0), true.radiance[dark].sum(axis=0), rtol=0.02)
    assert not got.clipped
    assert got.saturated == 0


def test_exposure_is_time_by_sensitivity_by_aperture(tmp_path):
    """The same exposures made by ISO and aperture give the same light, divided by N^2."""
    plain = frame_of(shots(tmp_path / "a"), transfer="linear")
    by_iso = frame_of(shots(tmp_path / "b", told=(0.25, 1 / 128, 1 / 4096), iso=1600, f_number=2.0), transfer="linear")
    np.testing.assert_allclose(by_iso.radiance, plain.radiance, rtol=1e-5)


def test_rounded_shutter_times_are_measured(tmp_path):
    """1/30 s is 1/32 and so on: read as told, the light of the shorter exposures is 6 % off."""
    light = np.minimum(scene(), 200)
    folder = shots(tmp_path / "s", light=light, exposures=(1.0, 1 / 4, 1 / 32, 1 / 256), told=(1.0, 1 / 4, 1 / 30, 1 / 240))
    np.testing.assert_allclose(irradiance(frame_of(folder, transfer="linear")), irradiance(truth(tmp_path, light)), rtol=0.01)


def test_what_rounding_does_not_explain_is_believed_and_said(tmp_path, capsys):
    light = scene()
    got = frame_of(shots(tmp_path / "s", exposures=(1.0, 1 / 8), told=(1.0, 1 / 16), light=np.minimum(light, 6)), transfer="linear")
    assert "shot_001.png: its light is 2" in capsys.readouterr().err
    assert irradiance(got)[1] > 1.2 * irradiance(truth(tmp_path, np.minimum(light, 6)))[1]


def test_no_channel_alone_speaks_for_a_clipped_pixel(tmp_path):
    """A sun whose red is clipped in the middle exposure and whose blue is not keeps its colour."""
    light = np.full((SIZE, SIZE, 3), 0.05)
    light[46:50, 46:50] = (60.0, 25.0, 6.0)
    got = frame_of(shots(tmp_path / "s", "srgb.png", light=light), transfer="srgb")
    np.testing.assert_allclose(irradiance(got), irradiance(truth(tmp_path, light)), rtol=0.01)


def test_light_clipped_in_every_exposure_is_a_lower_bound(tmp_path, capsys):
    folder = shots(tmp_path / "s", exposures=(1.0, 1 / 32), light=scene())
    got, true = frame_of(folder, transfer="linear"), truth(tmp_path)
    assert got.clipped
    assert got.saturated > 10
    assert "shot_000.png: light is clipped in its shortest exposure, too" in capsys.readouterr().err
    assert np.all(irradiance(got) < irradiance(true))
    assert got.radiance.max() > 20  # 1 / (1/32), diluted in its cell: what the shortest exposure says

    from vemlight.commands.offline import write_lights_file
    from vemlight.commands.options import LightsOptions

    write_lights_file(LightsOptions(source=folder, brackets=True, transfer="linear", out=tmp_path / "l.json", count=8))
    assert json.loads((tmp_path / "l.json").read_text())["clipped"] is True


def test_light_clipped_in_every_exposure_is_estimated_by_a_meter(tmp_path):
    folder = shots(tmp_path / "s", exposures=(1.0, 1 / 32))
    (folder / "response.toml").write_text('kind = "linear"\nbits = 16\na = 0.0\nb = 65535.0\nluminance_scale = 100.0\n')

    def level_lux(frame):
        return 100 * luminance_from_rgb(horizontal_irradiance(frame.radiance, frame.bright_cells))

    seen, true = frame_of(folder), truth(tmp_path)
    got = frame_of(folder, meter_lux=level_lux(true))
    assert (seen.clipped, got.clipped, seen.estimated_lux) == (True, True, 0)
    assert level_lux(got) == pytest.approx(level_lux(true), rel=0.005)
    assert level_lux(seen) + got.estimated_lux == pytest.approx(level_lux(true), rel=1e-6)
    # the sun is white where it was clipped
    np.testing.assert_allclose(luminance_from_rgb(irradiance(got)), luminance_from_rgb(irradiance(true)), rtol=0.02)


def test_a_log_of_weights_finds_little_light_between_noise(tmp_path):
    """Over five decades the mean of a cell is unbiased, and its pixels' noise is below 10 % where weights are those of least variance."""
    light = np.repeat((10.0 ** np.linspace(-2.6, 2.2, SIZE))[None, :, None] * np.ones((SIZE, 1, 1)), 3, axis=2)
    got = frame_of(shots(tmp_path / "s", light=light), transfer="linear")
    true = truth(tmp_path, light)
    solid = cell_solid_angles(90, 360, "hemisphere")[:, None, None]
    for decade in range(-2, 2):
        cells = (true.radiance[..., 1] > 10.0**decade) & (true.radiance[..., 1] < 10.0 ** (decade + 1))
        sums = [(frame.radiance * solid)[cells].sum() for frame in (got, true)]
        assert sums[0] == pytest.approx(sums[1], rel=0.0055)
        assert np.std(got.radiance[cells] / true.radiance[cells]) < 0.1


@pytest.mark.parametrize(("exposures", "groups"), [
    ([1, 4, 16], [[2, 1, 0]]),
    ([4, 1, 16], [[2, 0, 1]]),  # as many cameras take them: as metered, darker, brighter
    ([4, 1, 16, 4, 1, 16], [[2, 0, 1], [5, 3, 4]]),
    ([1, 4, 1, 4, 1, 4], [[1, 0], [3, 2], [5, 4]]),
    ([1, 4, 16, 1.2, 4.8, 19], [[2, 1, 0], [5, 4, 3]]),  # the meter drifts between two rising brackets
    ([1, 4, 16, 4, 1], [[2, 1, 0], [3, 4]]),  # up and down
    ([1, 4, 16, 16, 4, 1], [[2, 1, 0], [3, 4, 5]]),
    ([1, 1.26, 1.59], [[2, 1, 0]]),  # thirds of a stop
    ([8, 2, 4, 16, 32], [[4, 3, 0, 2, 1]]),  # one bracket of five
    ([1, 4, 16, 1.03, 4.1, 15.8], [[2, 1, 0], [5, 4, 3]]),
])  # fmt: skip
def test_which_photographs_are_a_frame(exposures, groups):
    assert exposure_groups([Photograph(f"p{k}.jpg", t) for k, t in enumerate(exposures)], "shots") == groups


@pytest.mark.parametrize(("exposures", "said"), [
    ([1.0], "shots: holds 1 photograph"),
    ([1.0, 1.01, 1.0], "shots: its 3 photographs have one exposure, 1 s"),
    ([1, 4, 4, 16], "p2.jpg: has the exposure of p1.jpg, 4 s"),
    ([1, 1.04, 4], "p0.jpg: has the exposure of p1.jpg"),
    ([1, 4, 16, 4, 1, 4, 4], "p6.jpg: has the exposure of p5.jpg"),
    ([1, 4, 16, 4, 1, 4], "p5.jpg: has no other exposure beside it"),
])  # fmt: skip
def test_what_is_no_bracket_is_refused(exposures, said):
    with pytest.raises(UserError, match=said):
        exposure_groups([Photograph(f"p{k}.jpg", t) for k, t in enumerate(exposures)], "shots")


def test_frames_of_a_folder_follow_each_other(tmp_path):
    folder = shots(tmp_path / "s", exposures=EXPOSURES * 2)
    source = open_files(Capture(source=str(folder), brackets=True, transfer="linear", fps=10))
    assert len(source) == 2
    assert source.frame(1).time_s == pytest.approx(0.1)
    np.testing.assert_allclose(irradiance(source.frame(1)), irradiance(source.frame(0)), rtol=0.01)


@pytest.mark.parametrize("exposure_s", [1.0, 0.01])
def test_a_response_holds_for_its_own_exposure(tmp_path, exposure_s):
    """code = f(L t / exposure_s): light in the response's unit, whatever the times of the bracket."""
    folder = tmp_path / "s"
    folder.mkdir()
    (folder / "lens.toml").write_text(LENS)
    response = Linear(bits=12, a=64.0, b=3000.0, exposure_s=exposure_s)
    write_response(folder / "response.toml", response)
    light = np.minimum(scene()[..., 1], 300)
    for k, t in enumerate(EXPOSURES):
        write_photograph(folder / f"{k}.png", code_from_radiance(light * t, response), t * exposure_s)
    got = frame_of(folder)
    np.testing.assert_allclose(irradiance(got), irradiance(truth(tmp_path, np.repeat(light[..., None], 3, axis=2))), rtol=0.01)


def test_raw_frames_of_a_recording_are_a_bracket(tmp_path):
    folder = tmp_path / "s"
    folder.mkdir()
    (folder / "lens.toml").write_text(LENS)
    response = Linear(bits=12, a=64.0, b=3000.0)
    write_response(folder / "response.toml", response)
    light = np.full((SIZE, SIZE, 3), (0.5, 1.0, 2.0)) * np.linspace(0.1, 20, SIZE)[:, None, None]
    mosaic = np.where(np.add.outer(np.arange(SIZE), np.arange(SIZE)) % 2, light[..., 1], light[..., 0])
    mosaic[1::2, 1::2] = light[1::2, 1::2, 2]
    for k, t in enumerate((1.0, 1 / 32)):
        header = {"vemlight:kind": "codes", "vemlight:mosaic": "RGGB", "expTime": t}
        write_exr(folder / f"{k}.exr", code_from_radiance(mosaic * t, response).astype(np.float32), header)
    np.testing.assert_allclose(irradiance(frame_of(folder)), irradiance(truth(tmp_path, light)), rtol=0.01)


def test_raw_photographs_are_read_from_their_mosaic(tmp_path):
    """A camera whose channels are CIE XYZ: gray stays gray, and light above the sensor's white is in the shorter exposure."""
    pytest.importorskip("rawpy", reason="rawpy is not installed: pip install 'vemlight[raw]'")
    black, white, folder = 512, 16_383, tmp_path / "s"
    folder.mkdir()
    (folder / "lens.toml").write_text(LENS)
    light = np.repeat(np.geomspace(0.05, 20, SIZE)[:, None], SIZE, axis=1)
    neutral = np.tile([[0.9505, 1.0], [1.0, 1.0888]], (SIZE // 2, SIZE // 2))
    for k, t in enumerate((0.5, 1 / 64)):
        codes = np.clip(np.rint(black + (white - black) * light * neutral * t), 0, white)
        (folder / f"{k}.dng").write_bytes(dng(codes, black, white, exposure_s=t))
    got = irradiance(frame_of(folder))
    np.testing.assert_allclose(got / got[1], 1, rtol=0.01)
    single = irradiance(open_files(Capture(source=str(folder / "1.dng"))).frame(0))  # its unit is the white of that exposure
    np.testing.assert_allclose(got, single * 64, rtol=0.02)


def test_a_still_without_exposure_names_its_file(tmp_path):
    folder = shots(tmp_path / "s")
    write_photograph(folder / "shot_001.png", np.zeros((SIZE, SIZE, 3), np.uint16))
    with pytest.raises(UserError, match=r"shot_001\.png: does not say its exposure time"):
        frame_of(folder, transfer="linear")


@pytest.mark.parametrize(("exposure_s", "said"), [
    (IFDRational(0, 1), "does not say its exposure time"),
    (IFDRational(1, 0), "its exposure time is nan"),
    (IFDRational(10**7, 1), "its exposure time is 10000000"),
])  # fmt: skip
def test_impossible_exposures_are_refused(tmp_path, exposure_s, said):
    folder = shots(tmp_path / "s")
    write_photograph(folder / "shot_001.png", np.zeros((SIZE, SIZE, 3), np.uint16), exposure_s)
    with pytest.raises(UserError, match=rf"shot_001\.png: .*{said}"):
        frame_of(folder, transfer="linear")


def replaced(folder, codes, exposure_s=1 / 32, suffix="png", **tags):
    (folder / "shot_001.png").unlink()
    write_photograph(folder / f"shot_001.{suffix}", codes, exposure_s, **tags)


@pytest.mark.parametrize(("spoil", "said"), [
    (lambda folder: replaced(folder, np.zeros((48, SIZE, 3), np.uint16)), r"shot_001\.png: is 96x48 and shot_000\.png 96x96"),
    (lambda folder: replaced(folder, np.zeros((SIZE, SIZE), np.uint16)), r"shot_001\.png: holds other codes than shot_000\.png"),
    (lambda folder: replaced(folder, np.zeros((SIZE, SIZE, 3), np.uint8)), r"shot_001\.png: holds other codes than shot_000\.png"),
    (lambda folder: replaced(folder, np.zeros((SIZE, SIZE, 3), np.uint16), f_number=4.0), r"shot_000\.png: does not say its f-number"),
    (lambda folder: (folder / "shot_001.png").write_bytes(b"\x89PNG\r\n\x1a\n cut"), r"shot_001\.png: is a PNG picture that is cut off"),
    (lambda folder: write_response(folder / "response.toml", Log(bits=16, a=1.0, b=2.0, c=1.0)), "its response is that of a log sensor"),
    (lambda folder: write_response(folder / "response.toml", Srgb(bits=8)), r"shot_000\.png: has code \d+ and the response 8 bits"),
])  # fmt: skip
def test_things_that_do_not_go_together_are_refused(tmp_path, spoil, said):
    folder = shots(tmp_path / "s")
    spoil(folder)
    with pytest.raises(UserError, match=said):
        frame_of(folder, transfer="" if (folder / "response.toml").exists() else "linear")


@pytest.mark.parametrize("transfer", ["pq", "slog3", "hlg"])
def test_curves_that_no_exposure_multiplies_are_refused(tmp_path, transfer):
    with pytest.raises(UserError, match=f"is {transfer}, whose codes no exposure multiplies"):
        frame_of(shots(tmp_path / "s"), transfer=transfer)


def test_radiance_and_single_files_are_no_brackets(tmp_path):
    with pytest.raises(UserError, match="is one file, and brackets are a folder"):
        frame_of(shots(tmp_path / "s") / "shot_000.png")
    for k in (1, 2):
        write_exr(tmp_path / "s" / f"{k}.exr", scene().astype(np.float32), {"expTime": float(k)})
    with pytest.raises(UserError, match="holds radiance, which has no exposure"):
        frame_of(tmp_path / "s")


def test_the_lens_is_that_of_the_photographs(tmp_path):
    assert read_lens(shots(tmp_path / "s") / "lens.toml").size == (SIZE, SIZE)
    (tmp_path / "s" / "lens.toml").write_text(LENS.replace("96, 96", "64, 64"))
    with pytest.raises(UserError, match="is 96x96 and the lens file is for 64x64"):
        frame_of(tmp_path / "s", transfer="linear")


def test_a_photograph_that_would_take_all_memory_is_refused_before_it_does(tmp_path):
    """EXIF of a PNG may lie behind its pixels."""
    import struct
    import zlib

    folder = shots(tmp_path / "s")
    header = struct.pack(">IIBBBBB", 60_000, 60_000, 16, 2, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b"")]
    png = b"".join(struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks)
    (folder / "shot_001.png").write_bytes(b"\x89PNG\r\n\x1a\n" + png)
    with pytest.raises(UserError, match=r"shot_001\.png: .*60000"):
        frame_of(folder, transfer="linear")
