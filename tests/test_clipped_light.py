"""Clipped light is a lower bound, said as one, and on wish estimated by a light meter."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from vemlight.capture.clipped_light import level_lux
from vemlight.capture.colour_coding import colour_coding
from vemlight.capture.exposure_cycle import ExposureCycle
from vemlight.capture.exposure_merge import values_from_response
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.lens import Lens, direction_from_pixel, write_lens
from vemlight.capture.live_brackets import LiveBrackets
from vemlight.capture.planes import planes_from_image
from vemlight.capture.response import Linear, code_from_radiance, write_response
from vemlight.capture.source import open_files
from vemlight.capture.stage import map_message
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.colour_tags import ColourTags
from vemlight.light.images import write_exr
from vemlight.light.sphere import cell_directions, map_irradiance
from vemlight.runtime import wire
from vemlight.runtime.stamps import stamp
from vemlight.sampler.stage import SamplerStage
from vemlight.settings import Capture, Settings

SIZE, SCALE = 128, 100.0  # cd/m2 per unit
LENS = Lens(size=(SIZE, SIZE), f=(40.7, 40.7), c=(63.5, 63.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=90.0)
RESPONSE = Linear(bits=12, a=64.0, b=40.0, luminance_scale=SCALE)  # clips at a radiance of 101
SUN = (70, 44)


def lux_of(frame: Frame) -> float:
    return level_lux(frame.radiance, frame.coverage, frame.bright_cells, SCALE)


def scene(times: float) -> np.ndarray:
    """A sky brighter to one side, and a sun of eight pixels so many times above what the sensor can show."""
    y, x = np.mgrid[:SIZE, :SIZE]
    light = 1 + 3 * x / SIZE
    light[(x - SUN[0]) ** 2 + (y - SUN[1]) ** 2 <= 3] = 101 * times
    return light


def frame_of(folder: Path, image: np.ndarray, kind: str, **settings: Any) -> Frame:
    """By one exposure of a sensor, by two of a live camera, or by a picture in colour."""
    write_lens(folder / "lens.toml", LENS)
    write_response(folder / "response.toml", RESPONSE)
    maker = FrameMaker(Capture(**settings), folder)
    codes = code_from_radiance(image, RESPONSE)
    if kind in ("mono", "RGGB"):
        return maker.frame_from_codes("one", codes, "mono" if kind == "mono" else "RGGB", 0.0)
    if kind == "colour":
        return maker.frame_from_codes("one", np.repeat(codes[..., None], 3, axis=-1), None, 0.0)
    if kind == "picture":
        coding = colour_coding(Capture(), "one", ColourTags("srgb", "bt709", "rgb", "full"), response=RESPONSE)
        return maker.frame_from_planes("one", planes_from_image(np.repeat(codes[..., None], 3, axis=-1), 12), coding, 0.0)
    live = LiveBrackets(maker, "one", ExposureCycle((4.0, 1.0)), values_from_response(RESPONSE, 0), "mono" if kind == "live" else "RGGB")
    for t in (4.0, 1.0, 4.0):
        frame, _ = live.frame(code_from_radiance(image * t, RESPONSE), 0.0)
    return frame


def truth(folder: Path, image: np.ndarray) -> Frame:
    folder = folder / "truth"
    folder.mkdir()
    write_lens(folder / "lens.toml", LENS)
    write_exr(folder / "truth.exr", np.repeat(image[..., None], 3, axis=-1).astype(np.float32), {"vemlight:kind": "fisheye"})
    return open_files(Capture(source=str(folder / "truth.exr"))).frame(0)


@pytest.mark.parametrize("kind", ["mono", "RGGB", "colour", "picture", "live", "live mosaic"])
@pytest.mark.parametrize("times", [6, 30])
def test_a_meter_brings_back_what_was_clipped(tmp_path: Path, kind: str, times: float) -> None:
    image = scene(times)
    true = truth(tmp_path, image)
    seen = frame_of(tmp_path, image, kind)
    got = frame_of(tmp_path, image, kind, meter_lux=lux_of(true))
    power = [luminance_from_rgb(map_irradiance(frame.radiance, "hemisphere")) for frame in (seen, got, true)]
    assert power[0] < 0.9 * power[2]
    assert power[1] == pytest.approx(power[2], rel=0.01)
    assert lux_of(got) == pytest.approx(lux_of(true), rel=0.005)
    assert got.estimated_lux == pytest.approx(lux_of(true) - lux_of(seen), rel=0.01)
    assert seen.estimated_lux == 0
    # the sky is as it was
    sky = cell_directions(90, 360, "hemisphere") @ direction_from_pixel(np.array(SUN, float), LENS) < np.cos(np.radians(8))
    np.testing.assert_array_equal(got.radiance[sky], seen.radiance[sky])


@pytest.mark.parametrize("kind", ["mono", "picture", "live"])
def test_without_clipped_light_a_meter_changes_nothing(tmp_path: Path, kind: str) -> None:
    plain, with_meter = (frame_of(tmp_path, scene(0.2), kind, **given) for given in ({}, {"meter_lux": 1e5}))
    assert with_meter.radiance.tobytes() == plain.radiance.tobytes()
    assert with_meter.estimated_lux == 0


def test_a_reading_that_is_not_more_is_no_estimate(tmp_path: Path, capsys) -> None:
    plain = frame_of(tmp_path, scene(2), "mono")
    got = frame_of(tmp_path, scene(2), "mono", meter_lux=1.05 * lux_of(plain))
    assert got.radiance.tobytes() == plain.radiance.tobytes()
    assert (got.clipped, got.estimated_lux) == (True, 0)
    assert "is not more than the map's own light by 10 %: it stays a lower bound" in capsys.readouterr().err


def test_light_below_the_horizon_is_no_concern_of_a_meter_that_looks_up(tmp_path: Path, capsys) -> None:
    """A camera on its side: half of what it sees is below the horizon."""
    on_its_side = msgspec.structs.replace(LENS, world_from_camera=((0, 0, 1), (-1, 0, 0), (0, -1, 0)))
    image = scene(10)
    image[90:93, 60:63] = 5000
    maps = []
    for lux in (0.0, 30_000.0):
        write_lens(tmp_path / "lens.toml", on_its_side)
        write_response(tmp_path / "response.toml", RESPONSE)
        maker = FrameMaker(Capture(coverage="sphere", meter_lux=lux), tmp_path)
        maps.append(maker.frame_from_codes("one", code_from_radiance(image, RESPONSE), "mono", 0.0))
    half = len(maps[0].radiance) // 2
    np.testing.assert_array_equal(maps[0].radiance[half:], maps[1].radiance[half:])
    assert maps[1].radiance[:half].max() > 5 * maps[0].radiance[:half].max()
    image[:64] = 1  # now nothing above it is clipped
    maker = FrameMaker(Capture(coverage="sphere", meter_lux=30_000.0), tmp_path)
    assert maker.frame_from_codes("one", code_from_radiance(image, RESPONSE), "mono", 0.0).estimated_lux == 0
    assert "it is below the horizon" in capsys.readouterr().err


def test_a_meter_needs_codes_and_a_unit(tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.toml", LENS)
    with pytest.raises(UserError, match="one: holds radiance"):
        FrameMaker(Capture(meter_lux=1e4), tmp_path).frame("one", np.ones((SIZE, SIZE, 3), np.float32), {}, 0.0)
    write_response(tmp_path / "response.toml", Linear(bits=12, a=64.0, b=40.0))
    maker = FrameMaker(Capture(meter_lux=1e4), tmp_path)
    with pytest.raises(UserError, match="one: meter_lux needs a sensor's response file with luminance_scale"):
        maker.frame_from_codes("one", np.full((SIZE, SIZE), 99, np.uint16), "mono", 0.0)


def test_what_was_clipped_and_estimated_reaches_rows_and_messages(tmp_path: Path) -> None:
    from vemlight.commands.offline import write_lights_file
    from vemlight.commands.options import LightsOptions

    frame = frame_of(tmp_path, scene(30), "mono", meter_lux=50_000.0)
    _, (header, _) = SamplerStage(Settings()).step(SamplerStage(Settings()).start_at(0)[0], map_message(frame, stamp(0, 0.0)))
    assert isinstance(header, wire.LightsMessage)
    assert (header.clipped, header.estimated_lux) == (True, frame.estimated_lux)
    folder = tmp_path / "codes"
    folder.mkdir()
    write_lens(folder / "lens.toml", LENS)
    write_response(folder / "response.toml", RESPONSE)
    codes = code_from_radiance(scene(30), RESPONSE).astype(np.float32)
    write_exr(folder / "a.exr", np.repeat(codes[..., None], 3, axis=-1), {"vemlight:kind": "codes", "vemlight:mosaic": "mono"})
    write_lights_file(LightsOptions(source=folder, meter_lux=50_000.0, out=tmp_path / "l.json", count=8))
    row = json.loads((tmp_path / "l.json").read_text())
    assert row["clipped"] is True
    assert row["estimated_lux"] == pytest.approx(frame.estimated_lux)
    total = sum(light["irradiance"][1] for light in row["lights"])
    assert total == pytest.approx(map_irradiance(frame.radiance, "hemisphere")[1], rel=1e-3)
