"""Cameras whose exposure changes from frame to frame: recognised, merged, strong lights followed; live, recorded and replayed alike."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vemlight.capture import camera_source
from vemlight.capture.camera_source import CameraSource
from vemlight.capture.colour_coding import colour_coding
from vemlight.capture.exposure_camera import values_from_coding
from vemlight.capture.exposure_cycle import SETTLING, ExposureCycle, ExposureRecogniser
from vemlight.capture.exposure_merge import CodeValues, values_from_response
from vemlight.capture.exposure_recording import ExposureRecording
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.lens import Lens, write_lens
from vemlight.capture.live_brackets import LiveBrackets
from vemlight.capture.pixel_formats import FORMATS
from vemlight.capture.planes import codes_from_planes, layout_of, linear_from_planes, planes_from_image
from vemlight.capture.response import Linear, Log, code_from_radiance, write_response
from vemlight.capture.scatter import ONE_THREAD
from vemlight.capture.simulation.exposing import exposures_of_frames
from vemlight.capture.simulation.sensor import VirtualCamera
from vemlight.capture.simulation.simulate import Lighting, simulate
from vemlight.capture.source import open_files
from vemlight.capture.strong_lights import REACH, StrongLight, add_lights, strong_lights, window_on
from vemlight.capture.v4l2 import RawFrame
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.colour_tags import ColourTags
from vemlight.light.images import read_radiance
from vemlight.light.sphere import cell_solid_angles, direction_from_angles, map_irradiance
from vemlight.settings import Capture

SIZE = 128
LENS = Lens(size=(SIZE, SIZE), f=(40.7, 40.7), c=(63.5, 63.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=90.0)
RESPONSE = Linear(bits=12, a=64.0, b=4000.0)
EXPOSURES = (0.064, 0.002, 0.0000625)
SOLID = cell_solid_angles(90, 360, "hemisphere")[:, None]
DIRECTIONS = direction_from_angles((np.arange(90)[:, None] + 0.5) * np.pi / 180, (np.arange(360) + 0.5) * np.pi / 180)


@pytest.fixture(scope="module", params=[("mono", 1), ("RGGB", 3), (None, 4)], ids=["mono", "mosaic", "colour"])
def played(request, tmp_path_factory) -> Path:
    """A recording of a swaying camera with losses, whose exposures nobody tells."""
    mosaic, delay = request.param
    folder = tmp_path_factory.mktemp("rec")
    camera = VirtualCamera(
        lens=LENS, response=RESPONSE, mosaic=mosaic, fps=60, exposures=EXPOSURES, control_delay=delay, noise_codes=1.0, dropouts=0.15
    )
    lighting = Lighting(maps=("sky",), sway_deg=2.0, sway_hz=1.5)
    simulate(lighting, camera, folder, frames=48, truth_maps=True, seed=3)
    return folder


def source_of(folder: Path, **settings: Any) -> ExposureRecording:
    source = open_files(Capture(source=str(folder), **settings))
    assert isinstance(source, ExposureRecording)
    return source


def truth_rows(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "truth.jsonl").read_text().splitlines()]


def true_exposures(folder: Path) -> list[float]:
    return [row["exposure_s"] for row in truth_rows(folder)][SETTLING - 1 :]


def sun(frame: Frame, near: np.ndarray) -> tuple[float, np.ndarray]:
    """Power and direction of the light within 8 degrees of a direction."""
    flux = luminance_from_rgb(frame.radiance) * SOLID
    flux[DIRECTIONS @ near < np.cos(np.radians(8))] = 0
    flat, cells = flux.ravel(), frame.bright_cells
    whole = np.ones(len(flat), bool)
    whole[cells.cells] = False
    moment = flat[whole] @ DIRECTIONS.reshape(-1, 3)[whole] + (flat[cells.cells] * cells.weights) @ cells.directions
    return float(flat.sum()), moment / np.linalg.norm(moment)


def test_every_frame_is_recognised(played, monkeypatch):
    found = []
    plain = ExposureRecogniser.recognised

    def recorded(self, *args):
        found.append(plain(self, *args))
        return found[-1]

    monkeypatch.setattr(ExposureRecogniser, "recognised", recorded)
    source = source_of(played)
    source.frame(len(source) - 1)
    assert [EXPOSURES[n] for n in found] == true_exposures(played)[1:]
    assert true_exposures(played)[0] == EXPOSURES[1]


def test_the_sun_is_whole_and_in_its_place_in_every_frame(played):
    """After two cycles; the power against that of the same lens's image of the true radiance."""
    source, exact, rows = source_of(played), open_files(Capture(source=str(played / "truth"))), truth_rows(played)
    assert len(exact) == len(source) + SETTLING - 1
    of_mosaic = "RGGB" in str(read_radiance(played / rows[0]["name"])[1].get("vemlight:mosaic"))
    for k in range(2 * len(EXPOSURES), len(source)):
        near = np.array(rows[k + SETTLING - 1]["sun"])
        power, direction = sun(source.frame(k), near)
        true_power, _ = sun(exact.frame(k + SETTLING - 1), near)
        assert of_mosaic or power == pytest.approx(true_power, rel=0.05)  # a sun sharper than a mosaic has no power that it tells
        assert LENS.f[0] * np.arccos(np.clip(direction @ near, -1, 1)) < (1.5 if of_mosaic else 0.5)  # pixels; of one that is in one


def test_a_frame_has_the_same_bits_in_any_order(played):
    if "mono" not in str(read_radiance(played / truth_rows(played)[0]["name"])[1].get("vemlight:mosaic")):
        return  # once is enough
    first = [source_of(played).frame(k).radiance for k in (0, 1)]
    source = source_of(played)
    later = source.frame(9).radiance
    np.testing.assert_array_equal(source.frame(1).radiance, first[1])
    np.testing.assert_array_equal(source.frame(9).radiance, later)
    np.testing.assert_array_equal(source.frame(0).radiance, first[0])
    shifted = source_of(played, start=9)
    np.testing.assert_array_equal(shifted.frame(0).radiance, later)
    assert shifted.frame(0).time_s == 0.0


@pytest.mark.parametrize("delay", [1, 2, 3, 4])
def test_the_first_frame_that_is_used_has_the_exposure_that_was_held(delay):
    cycle = ExposureCycle(EXPOSURES)
    exposures = exposures_of_frames(cycle, delay, list(range(40)), 40)
    assert exposures[0] not in EXPOSURES
    assert exposures[SETTLING - 1] == EXPOSURES[1]
    assert exposures[20:23] != exposures[21:24]
    assert sorted(exposures[20:23]) == sorted(EXPOSURES)


def test_lost_frames_hold_the_cycle_up():
    """What was not received was not answered: the exposure stays for one frame more."""
    whole = exposures_of_frames(ExposureCycle(EXPOSURES), 2, list(range(30)), 30)
    lossy = exposures_of_frames(ExposureCycle(EXPOSURES), 2, [k for k in range(30) if k != 15], 30)
    assert lossy[:17] == whole[:17]
    assert lossy[17] == lossy[16] == whole[16]


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("moved", [(0.0, 0.0), (3.3, -1.6), (-4.0, 2.5)])
def test_a_light_that_is_moved_keeps_its_flux_and_centre(step, moved):
    """In a mosaic each colour by itself."""
    rng, image = np.random.default_rng(2), np.zeros((40, 40, 1), np.float32)
    excess = rng.random((5, 7, 1)).astype(np.float32)
    light = StrongLight(excess, (16, 12), {0: np.array([15.0 + moved[0], 18.0 + moved[1]]), 1: np.array([15.0, 18.0])}, 0)
    add_lights([light], 2, image, step)  # without a region: it is added
    before = np.zeros_like(image)
    before[16:21, 12:19] = excess
    y, x = np.indices((40, 40))
    for row, column in np.ndindex(step, step):
        after_colour, before_colour = (one[row::step, column::step, 0] for one in (image, before))
        own_x, own_y = x[row::step, column::step], y[row::step, column::step]
        assert after_colour.sum() == pytest.approx(before_colour.sum(), rel=1e-5)
        for axis, by in ((own_x, moved[0]), (own_y, moved[1])):
            centres = [(one * axis).sum() / one.sum() for one in (after_colour, before_colour)]
            assert centres[0] - centres[1] == pytest.approx(by, abs=1e-3)


def test_a_window_larger_than_the_search_stays_where_it_is(tmp_path):
    """Its centre within the search is no centre of it."""
    write_lens(tmp_path / "lens.toml", LENS)
    live = LiveBrackets(FrameMaker(Capture(), tmp_path), "cam", ExposureCycle((0.1, 0.005)), values_from_response(RESPONSE, 0), "mono")
    light = np.full((SIZE, SIZE), 0.5)
    light[30 : 30 + 2 * REACH, 20:120] = 100
    frames = [live.frame(code_from_radiance(light * t, RESPONSE), 0.0)[0] for t in (0.1, 0.005, 0.1)]
    np.testing.assert_allclose(frames[1].radiance.sum(), frames[2].radiance.sum(), rtol=0.01)


def test_the_likelier_exposure_is_the_one_that_claims_less():
    """1.4 times what one exposure gives, 0.7 times what the other does: about as many sigmas off, of which the shorter's is half."""
    values, spans = values_from_response(RESPONSE, 0), np.tile([0, SIZE], (SIZE, 1))
    recogniser = ExposureRecogniser(values, (1.0, 0.5), spans)
    radiance = np.full((SIZE, SIZE), 0.3, np.float32)
    codes = code_from_radiance(np.full((SIZE, SIZE), 0.7 * 0.3), RESPONSE)
    assert recogniser.recognised(codes.astype(np.uint16), radiance, 0) == 1


@pytest.mark.parametrize(("side", "is_followed"), [(REACH - 2, True), (REACH + 2, False)])
def test_a_light_is_followed_up_to_the_size_of_the_search(side, is_followed):
    values, spans = values_from_response(RESPONSE, 0), np.tile([0, SIZE], (SIZE, 1))
    codes = np.full((SIZE, SIZE, 1), 100, np.uint16)
    codes[40 : 40 + side - 2, 40 : 40 + side - 2] = 2000  # its region is a pixel wider on each side
    (light,) = strong_lights({2: codes}, values, EXPOSURES, spans, 1)
    assert (light.region is not None) == is_followed


def test_frames_are_laid_on_the_newest_by_the_lights_motion():
    light = StrongLight(np.ones((1, 1, 1), np.float32), (60, 50), {2: np.array([50.0, 60.0]), 0: np.array([45.0, 63.0])}, 2)
    rows, columns = window_on(light, 2, (SIZE, SIZE), 1)
    assert (rows[0], columns[0], len(rows)) == (60 - REACH, 50 - REACH, 2 * REACH + 1)
    moved_rows, moved_columns = window_on(light, 0, (SIZE, SIZE), 1)
    assert (moved_rows == rows + 3).all()
    assert (moved_columns == columns - 5).all()


def test_light_clipped_in_the_shortest_exposure_is_said(tmp_path, capsys):
    write_lens(tmp_path / "lens.toml", LENS)
    live = LiveBrackets(FrameMaker(Capture(), tmp_path), "cam", ExposureCycle((0.1, 0.005)), values_from_response(RESPONSE, 0), "mono")
    light = np.full((SIZE, SIZE), 0.5)
    light[60:64, 60:64] = 1000
    frames = [live.frame(code_from_radiance(light * t, RESPONSE), 0.0)[0] for t in (0.1, 0.005, 0.1)]
    assert [frame.clipped for frame in frames] == [False, True, True]
    assert frames[2].saturated == 16
    assert "cam: light is clipped in the shortest exposure, too" in capsys.readouterr().err


def coding_of(tags: ColourTags) -> Any:
    return colour_coding(Capture(), "cam", tags)


@pytest.mark.parametrize("layout", ["rgb24", "yuyv422", "nv12"])
def test_entries_of_a_coding_are_its_light(layout):
    """A camera in colour: planes to entries of the table to light, as planes to light."""
    rng = np.random.default_rng(4)
    coding = coding_of(ColourTags("srgb", "bt709", "bt601", "full"))
    if layout == "rgb24":
        planes = planes_from_image(rng.integers(0, 256, (16, 16, 3), np.uint8), 8)
    else:
        made = layout_of(layout)
        assert made is not None
        samples = (rng.integers(60, 190, (16, 32), np.uint8),) if layout == "yuyv422" else (
            rng.integers(60, 190, (16, 16), np.uint8), rng.integers(100, 150, (8, 16), np.uint8))  # fmt: skip
        planes = planes_from_image(np.zeros((16, 16, 3), np.uint8), 8)._replace(samples=samples, layout=made)
    spans = np.tile([0, 16], (16, 1))
    values = values_from_coding(coding, 8, 1.0)
    got = values.light[codes_from_planes(planes, coding, spans, ONE_THREAD)] @ values.rec709_from_light.T
    np.testing.assert_allclose(got, linear_from_planes(planes, coding, spans, ONE_THREAD).pixels, atol=4e-4, rtol=4e-3)


class Controls:
    """The exposure of a virtual camera, in counts of 100 us; gain has one value."""

    exposure_s, time_control, unit_s = 0.002, "exposure_time_absolute", 1e-4

    def __init__(self) -> None:
        self.log: list[int] = []
        self.values = {"exposure_time_absolute": 20, "gain": 0}

    def limits(self, name: str) -> tuple[int, int]:
        if name not in self.values:
            raise UserError(f"cam: has no control {name}; correct it")
        return (1, 10_000) if name != "gain" else (5, 5)

    def written(self, name: str, value: int) -> int:
        return value

    def write(self, name: str, value: int) -> None:
        self.log.append(value)


class VirtualDevice:
    """Replaces V4l2Camera: the sun moves, and a command takes effect two frames later."""

    def __init__(self, path: str, **_: Any) -> None:
        self.path, self.width, self.height, self.fps = path, SIZE, SIZE, 30.0
        self.form = next(form for form in FORMATS.values() if form.name == "Y12")
        self.state, self.controls, self.sent = "streams", Controls(), 0
        self.tags = self.unsaid = ColourTags()
        self.closed = False

    def read(self, wait_s: float) -> RawFrame | None:
        log = self.controls.log
        count = log[max(len(log) - 2, 0)] if self.sent >= 2 else 333
        y, x = np.mgrid[:SIZE, :SIZE]
        light = 1 + 30_000 * np.exp(-((x - 60 - 0.4 * self.sent) ** 2 + (y - 70) ** 2) / 4)
        self.sent += 1
        codes = code_from_radiance(light * count * 1e-4, RESPONSE)
        return RawFrame(codes, "mono", self.sent, self.sent * 33_000_000, 0)

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def camera(tmp_path, monkeypatch) -> dict[str, Any]:
    write_lens(tmp_path / "lens.toml", LENS)
    write_response(tmp_path / "response.toml", RESPONSE)
    monkeypatch.setattr(camera_source, "V4l2Camera", VirtualDevice)
    return {
        "source": "/dev/video0", "lens": str(tmp_path / "lens.toml"), "response": str(tmp_path / "response.toml"),
        "exposures": (0.0512, 0.0032, 0.0001),
    }  # fmt: skip


def test_what_a_camera_showed_is_what_its_recording_shows(camera, tmp_path, monkeypatch):
    """No frame is added, each has the truth's power, and the recording says which exposure each frame was found to have."""
    live = CameraSource(Capture(**camera, record=str(tmp_path / "out")))
    assert live.recorder is not None
    monkeypatch.setattr(live.recorder, "put", live.recorder.put_waiting)  # a test is faster than the disk
    frames = [live.next(0.1) for _ in range(SETTLING + 19)]
    assert frames[: SETTLING - 1] == [None] * (SETTLING - 1)
    shown = [frame for frame in frames if frame is not None]
    assert len(shown) == 20
    live.close()
    recording = source_of(tmp_path / "out")
    assert len(recording) == 20
    for k, frame in enumerate(shown):
        np.testing.assert_array_equal(recording.frame(k).radiance, frame.radiance)
    powers = [map_irradiance(frame.radiance, "hemisphere")[1] for frame in shown[6:]]
    np.testing.assert_allclose(powers, np.mean(powers), rtol=0.04)
    assert powers[0] > 20  # and not what the first exposure saw alone
    assert map_irradiance(shown[0].radiance, "hemisphere")[1] < 0.3 * powers[0]


@pytest.mark.parametrize(("changed", "said"), [
    ({"exposures": (0.01, 0.0100001)}, "are not two or more that differ by a tenth"),
    ({"exposures": (0.01, 0.000001)}, "an exposure of 1e-06 is not in its 0.0001 to 1 s"),
    ({"exposures": (5.0, 0.01)}, "an exposure of 5 is not in its 0.0001 to 1 s"),
    ({"exposure_control": "shutter"}, "has no control shutter"),
    ({"exposure_control": "gain"}, "is not in its 5 to 5 of gain"),
])  # fmt: skip
def test_exposures_that_a_camera_does_not_have_are_refused(camera, changed, said):
    with pytest.raises(UserError, match=said):
        CameraSource(Capture(**{**camera, **changed}))


def test_a_log_sensor_takes_all_light_at_once(camera, tmp_path):
    write_response(tmp_path / "response.toml", Log(bits=12, a=1500.0, b=190.0, c=1e-3))
    with pytest.raises(UserError, match="its response is that of a log sensor"):
        CameraSource(Capture(**camera))


@pytest.mark.parametrize(("settings", "said"), [
    ({"source": "film.mp4", "exposures": (1.0, 0.1)}, "exposures is for cameras"),
    ({"source": "http://camera/x", "exposures": (1.0, 0.1)}, "exposures is for cameras"),
    ({"source": "/dev/video0", "exposures": (1.0, 0.1), "controls": {"exposure_time_absolute": 3}}, "both set exposure_time_absolute"),
    ({"source": "/dev/video0", "brackets": True}, "brackets is for folders"),
])  # fmt: skip
def test_settings_that_do_not_go_together(settings, said):
    with pytest.raises(ValueError, match=said):
        Capture(**settings)


def test_the_virtual_camera_needs_codes_for_exposures(tmp_path):
    with pytest.raises(UserError, match="--exposures: are of raw codes"):
        simulate(Lighting(maps=("sky",)), VirtualCamera(lens=LENS, exposures=EXPOSURES), tmp_path / "out", frames=2)


def test_dark_is_where_the_light_begins():
    assert values_from_response(RESPONSE, 0).dark == 64
    plain = CodeValues(np.linspace(0, 1, 256), 250, 255, 0, np.eye(3), None)
    assert plain.dark == 0
