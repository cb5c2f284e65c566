"""A GenICam camera's frames: formats, what chunks and stamps tell, losses, outages; the producers are in test_genicam_producers.py."""

import numpy as np
import pytest

from tests.support.genicam import Device, Fault, Feature, camera_nodes, packed_gige, packed_lsb
from vemlight.capture import genicam_camera
from vemlight.capture.camera_source import CameraSource, raw_attributes
from vemlight.capture.genicam_camera import CameraClock, GenicamCamera, chosen_format, frames_missing
from vemlight.capture.lens import Lens, write_lens
from vemlight.capture.pixel_formats import PFNC_FORMATS, codes_from_bytes
from vemlight.capture.response import Linear, write_response
from vemlight.errors import UserError
from vemlight.light.images import read_exr
from vemlight.settings import Capture

NAME = "genicam:1"
TICKS_PER_S = 125_000_000


@pytest.fixture
def plugged(monkeypatch):
    """Lets cameras be found at a Device."""

    def plug(device):
        monkeypatch.setattr(genicam_camera, "connect", device.connect)
        monkeypatch.setattr(genicam_camera, "faults", lambda: (Fault,))
        monkeypatch.setattr(genicam_camera, "info_of", lambda module, name: getattr(module, name, None))
        monkeypatch.setattr(genicam_camera, "on_incomplete", lambda acquirer, call: setattr(acquirer, "on_incomplete", call))
        monkeypatch.setattr(genicam_camera, "RETRY_S", 0.0)
        return device

    return plug


def some_codes(bits, shape=(4, 8), seed=1):
    return np.random.default_rng(seed).integers(0, 2**bits, shape).astype(np.uint8 if bits == 8 else np.uint16)


def received(camera, count=1):
    frames = [camera.read(0.0) for _ in range(count)]
    return [frame for frame in frames if frame is not None]


@pytest.mark.parametrize("name", [name for name, form in PFNC_FORMATS.items() if form.mosaic])
@pytest.mark.parametrize(("width", "padding"), [(8, 0), (5, 0), (7, 3), (1, 0)])
def test_each_format_gives_the_codes_that_were_packed(name, width, padding):
    form = PFNC_FORMATS[name]
    assert form.bits == int("".join(filter(str.isdigit, name)))
    assert form.mosaic == {"Mo": "mono", "RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}[name.removeprefix("Bayer")[:2]]
    codes = some_codes(form.bits, (3, width))
    pack = packed_lsb if name.endswith("p") else packed_gige if name.endswith("Packed") else lambda some, _: some.tobytes()
    parts = [codes] if not padding else codes  # rows without padding follow each other bit by bit
    data = b"".join(pack(part, form.bits) + b"\xee" * padding for part in parts)
    stride = -(-width * form.stored_bits // 8) + padding
    got = codes_from_bytes(data, form, width, 3, stride)
    np.testing.assert_array_equal(got, codes)
    assert got.dtype == codes.dtype
    with pytest.raises(ValueError, match=f"no frame of {width}x3"):
        codes_from_bytes(data[: len(data) - padding - 1], form, width, 3, stride)


OFFERED = ["Mono8", "Mono12", "BayerRG8", "BayerRG12", "BayerRG12p", "RGB8", "BGR8", "YUV422_8"]


@pytest.mark.parametrize(
    ("form", "bits", "chosen"),
    [
        ("", 12, "BayerRG12p"), ("", 8, "BayerRG8"), ("", None, "RGB8"), ("BGR8", None, "BGR8"), ("Mono12", 12, "Mono12"),
        ("Mono12", None, "Mono12"), ("RGB8", 8, "RGB8"),
    ],
)  # fmt: skip
def test_the_format_is_the_sensors_own_of_the_responses_bits(form, bits, chosen):
    assert chosen_format("camera", OFFERED, form, bits).name == chosen


@pytest.mark.parametrize(
    ("offered", "form", "bits", "words"),
    [
        (OFFERED, "Mono10", 10, "has no format Mono10 but Mono8, Mono12"),
        (OFFERED, "YUV422_8", None, "YUV422_8 is not read"),
        (OFFERED, "Mono8", 12, "Mono8 has codes of 8 bits and the response file is for 12"),
        (OFFERED, "", 10, "has codes of 8 and 12 bits and the response file is for 10"),
        (["Coord3D_ABC32f"], "", None, "has no format that is read here but Coord3D_ABC32f"),
    ],
)
def test_formats_that_cannot_be_are_refused(offered, form, bits, words):
    with pytest.raises(UserError, match=words):
        chosen_format("camera", offered, form, bits)


@pytest.mark.parametrize(
    ("last", "now", "lost"),
    [(-1, 7, 0), (3, 4, 0), (3, 8, 4), (65535, 1, 0), (65534, 2, 2), (5, 5, 0), (500, 1, 0), (2**40, 2**40 + 3, 2), (2**40, 1, 0)],
)
def test_lost_frames_are_known_by_number(last, now, lost):
    assert frames_missing(last, now) == lost


def test_stamps_keep_the_cameras_spacing_whatever_the_delay():
    generator, clock = np.random.default_rng(2), CameraClock("genicam:even")
    delays_ns = (2e6 + generator.exponential(5e6, 200)).astype(int)
    got = [clock.monotonic_ns(1000 + 0.04 * k, 10**12 + 40_000_000 * k + int(delays_ns[k])) for k in range(200)]
    np.testing.assert_allclose(np.diff(got[100:]), 4e7, atol=1e5)
    assert got[-1] == pytest.approx(10**12 + 40_000_000 * 199 + delays_ns.min(), abs=1e4)


def test_stamps_that_are_not_there_or_run_wrong_are_told_and_not_believed(capsys):
    assert CameraClock("genicam:none").monotonic_ns(None, 77) == 77
    assert "genicam:none: tells no time" in capsys.readouterr().err
    clock = CameraClock("genicam:fast")
    got = [clock.monotonic_ns(8 * 0.04 * k, 10**12 + 40_000_000 * k) for k in range(100)]
    assert got[-1] == 10**12 + 40_000_000 * 99
    assert "genicam:fast: its clock runs 8 times as fast" in capsys.readouterr().err


def test_stamps_that_begin_again_are_laid_on_the_clock_anew():
    clock = CameraClock("genicam:again")
    for k in range(100):
        clock.monotonic_ns(5000 + 0.04 * k, 10**12 + 40_000_000 * k)
    assert clock.monotonic_ns(1.0, 2 * 10**12) == 2 * 10**12


def test_a_frames_exposure_and_time_are_those_of_its_chunks(plugged, monkeypatch):
    codes = some_codes(12)
    ticks = [10**9 + k * TICKS_PER_S // 25 for k in range(3)]
    told = [(codes, 1, 8000.0, ticks[0]), (codes, 2, 125.0, ticks[1]), (codes, 3, 500.0, ticks[2])]
    device = plugged(Device(camera_nodes(), told))
    camera = GenicamCamera(NAME, response_bits=12, controls={"ExposureTime": 8000})
    monkeypatch.setattr(camera._clock, "monotonic_ns", lambda stamp_s, arrived_ns: round(stamp_s * 1e9))
    frames = received(camera, 3)
    assert [frame.exposure_s for frame in frames] == pytest.approx([0.008, 125e-6, 500e-6])
    np.testing.assert_array_equal(frames[0].codes, codes)
    assert [frame.monotonic_ns for frame in frames] == [8 * 10**9 + 40_000_000 * k for k in range(3)]
    assert [raw_attributes(frame, 25.0, camera.controls)["expTime"] for frame in frames] == [frame.exposure_s for frame in frames]
    assert device.queued == 3
    camera.close()


def test_without_chunks_the_exposure_is_what_was_read_back(plugged):
    nodes = camera_nodes()
    del nodes.ChunkExposureTime, nodes.ChunkTimestamp
    device = plugged(Device(nodes, []))
    device.try_fetch = lambda timeout, is_raw: None
    camera = GenicamCamera(NAME, response_bits=12, controls={"ExposureTime": 8000})
    assert nodes.ChunkModeActive.value is False
    raw = genicam_camera.RawFrame(some_codes(12), "mono", 1, 1, 0)
    assert raw_attributes(raw, 25.0, camera.controls)["expTime"] == pytest.approx(0.008)


def test_all_is_restored_when_it_is_closed_and_the_stream_has_ended(plugged):
    nodes = camera_nodes(width=16)
    nodes.ChunkSelector.value = "Timestamp"
    before = nodes.values()
    device = plugged(Device(nodes, [(some_codes(12), 1, 250.0, 9)]))
    for name in ("PixelFormat", "Width", "ChunkModeActive"):  # which a camera holds while it streams
        getattr(nodes, name).locked = lambda: device.streams
    camera = GenicamCamera(NAME, response_bits=12, width=8, fps=50.0, controls={"ExposureTime": 8000})
    received(camera)
    assert nodes.values().items() >= {"PixelFormat": "Mono12", "Width": 8, "ChunkModeActive": True, "AcquisitionFrameRate": 50.0}.items()
    assert camera.fps == 50.0
    camera.close()
    after = nodes.values()
    assert {name: after[name] for name in before} == before
    for chunk in ("Image", "ExposureTime", "Timestamp"):
        nodes.ChunkSelector.value = chunk
        assert nodes.ChunkEnable.value is False


def test_a_part_of_the_sensor_is_set_where_it_was_and_restored(plugged):
    nodes = camera_nodes()
    nodes.Width = Feature(8, 2, lambda: 16 - nodes.OffsetX.value)
    nodes.OffsetX = Feature(8, 0, lambda: 16 - nodes.Width.value)
    before = nodes.values()
    plugged(Device(nodes, []))
    camera = GenicamCamera(NAME, response_bits=12, width=12, controls={"OffsetX": 2})
    assert (nodes.Width.value, nodes.OffsetX.value, camera.width) == (12, 2, 12)
    camera.close()
    assert nodes.values() == before


def test_incomplete_and_missing_frames_are_counted(plugged):
    codes = some_codes(12)
    told = [
        (codes, 10, None, None),
        "incomplete",
        (codes, 12, None, None),
        (codes, 17, None, None),
        "incomplete",
        (codes, None, None, None),
    ]
    plugged(Device(camera_nodes(), told))
    camera = GenicamCamera(NAME, response_bits=12)
    assert [frame.lost for frame in received(camera, 6)] == [0, 1, 4, 1]


def test_padded_and_big_endian_rows(plugged):
    codes = some_codes(12)
    device = plugged(Device(camera_nodes(), [(codes, 1, None, None)]))
    device.info = {"padding_x": 4, "pixel_endianness": genicam_camera.BIG_ENDIAN}
    device.encode = lambda frame: b"".join(row.astype(">u2").tobytes() + b"\xee" * 4 for row in frame)
    np.testing.assert_array_equal(received(GenicamCamera(NAME, response_bits=12))[0].codes, codes)


@pytest.mark.parametrize("form", ["RGB8", "BGR8", "RGBa8", "BGRa8"])
def test_pictures_in_colour_are_linear_light(plugged, form):
    rgb = np.random.default_rng(4).integers(0, 256, (4, 8, 3)).astype(np.uint8)
    sent = rgb[..., ::-1] if form.startswith("BGR") else rgb
    sent = np.concatenate([sent, np.full((4, 8, 1), 255, np.uint8)], axis=-1) if "a8" in form else sent
    plugged(Device(camera_nodes(("Mono8", form)), [(np.ascontiguousarray(sent), 1, None, None)] * 2))
    source = CameraSource(Capture(source=NAME, rows=2, cols=8, coverage="sphere", projection="equirect"))
    frame = source.next(0.0)
    assert frame is not None
    source.close()
    north = (rgb[0].astype(float) + rgb[1]).mean(axis=0) / 2 / 255
    np.testing.assert_allclose(frame.radiance[0].mean(axis=0), north, rtol=0.2)
    assert frame.radiance.max() <= 1.0 + 1e-6


def test_another_size_or_kind_of_frame_is_refused(plugged):
    device = plugged(Device(camera_nodes(), [(some_codes(12, (4, 6)), 1, None, None)]))
    camera = GenicamCamera(NAME, response_bits=12)
    with pytest.raises(UserError, match="sent a picture of 6x4 and had agreed to 8x4"):
        camera.read(0.0)
    assert device.queued == 1


def test_an_unplugged_camera_is_waited_for_and_known_again(plugged):
    codes = some_codes(12)
    nodes = camera_nodes()
    device = plugged(Device(nodes, [(codes, 1, 250.0, 10**9), Fault("link lost"), (codes, 1, 250.0, 5)]))
    camera = GenicamCamera("genicam:first", response_bits=12, controls={"ExposureTime": 8000})
    assert received(camera, 2)[0].lost == 0
    assert camera.state == "genicam:first: is gone (link lost); waiting for it"
    assert camera.read(0.0) is None
    device.is_there, nodes.ExposureAuto.value = True, "Continuous"  # as it is after power has come back
    (frame,) = received(camera)
    assert (frame.lost, device.found_by) == (0, "ID 1")
    assert (nodes.ExposureAuto.value, nodes.ExposureTime.value) == ("Off", 8000.0)
    assert "Maker Model, Mono12 8x4" in camera.state


@pytest.mark.parametrize("has_lost_power", [False, True])
def test_after_outages_what_was_there_at_first_is_restored(plugged, has_lost_power):
    nodes = camera_nodes()
    before = nodes.values()
    device = plugged(Device(nodes, []))
    camera = GenicamCamera(NAME, response_bits=12, controls={"ExposureTime": 8000})
    assert camera.controls is not None
    remembered = len(camera.controls._before)
    for _ in range(3):
        device.frames = [Fault("link lost")]
        received(camera)
        device.is_there = True
        if has_lost_power:
            nodes.ExposureTime.value, nodes.ExposureAuto.value = before["ExposureTime"], before["ExposureAuto"]
        received(camera)
        assert (nodes.ExposureAuto.value, nodes.ExposureTime.value) == ("Off", 8000.0)
    assert len(camera.controls._before) == remembered  # and no more for each outage
    camera.close()
    assert nodes.values() == before


def test_one_that_comes_back_with_another_size_is_refused(plugged):
    nodes = camera_nodes()
    device = plugged(Device(nodes, [Fault("link lost")]))
    camera = GenicamCamera(NAME, response_bits=12)
    received(camera)
    device.is_there, nodes.Width = True, Feature(16, 2, 4096)
    with pytest.raises(UserError, match="came back with Mono12 16x4 instead of Mono12 8x4"):
        camera.read(0.0)


def test_one_that_is_silent_is_asked_whether_it_is_there(plugged, monkeypatch):
    monkeypatch.setattr(genicam_camera, "SILENT_S", 0.0)
    nodes = camera_nodes()
    plugged(Device(nodes, []))
    camera = GenicamCamera(NAME, response_bits=12)
    assert camera.read(0.0) is None
    assert "8x4" in camera.state  # a trigger may be slow
    nodes.Width.mode = 1
    assert camera.read(0.0) is None
    assert "is gone (not available)" in camera.state


def calibrated(folder, bits=12, **more):
    """Settings with a response and a lens of 8 x 4 pixels that sees half of the sphere of directions."""
    write_response(folder / "response.toml", Linear(bits=bits, a=0.0, b=2.0**bits - 1))
    write_lens(folder / "lens.toml", Lens(size=(8, 4), f=(2.0, 2.0), c=(3.5, 1.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=90.0))
    files = {"response": str(folder / "response.toml"), "lens": str(folder / "lens.toml")}
    return Capture(**{"source": NAME, "rows": 4, "cols": 8, **files, **more})


def test_recorded_frames_have_their_chunks_exposure_and_play_back(plugged, tmp_path):
    codes = [some_codes(12, (4, 8), seed) for seed in (1, 2)]
    plugged(Device(camera_nodes(), [(codes[0], 1, 8000.0, 5), (codes[1], 2, 7990.0, 9)]))
    settings = calibrated(tmp_path, controls={"ExposureTime": 8000}, record=str(tmp_path / "out"))
    source = CameraSource(settings)
    assert [source.next(0.0) is None for _ in range(2)] == [False, False]
    source.close()
    for path, sent, exposure_s in zip(sorted((tmp_path / "out").glob("*.exr")), codes, (0.008, 0.00799), strict=True):
        pixels, attributes = read_exr(path)
        np.testing.assert_array_equal(pixels[..., 0], sent)
        assert attributes["expTime"] == pytest.approx(exposure_s)
        assert '"ExposureTime": 8000.0' in attributes["vemlight:controls"]


def test_frames_that_tell_another_exposure_than_was_set_are_told(plugged, tmp_path, capsys):
    plugged(Device(camera_nodes(), [(some_codes(12), 1, 16000.0, 5)]))
    CameraSource(calibrated(tmp_path, source="genicam:willful", controls={"ExposureTime": 8000})).next(0.0)
    assert "genicam:willful: frames tell other exposures than the 0.008 s that is set" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("bits", "words"),
    [
        (None, r'sends raw codes \(Mono12\), which need a response file; a linear sensor\'s says kind = "linear", bits = 12'),
        (10, "codes of 8 and 12 bits and the response file is for 10"),
    ],
)
def test_raw_codes_need_a_response_of_their_bits(plugged, tmp_path, monkeypatch, bits, words):
    monkeypatch.chdir(tmp_path)
    nodes = camera_nodes()
    before = nodes.values()
    plugged(Device(nodes, []))
    with pytest.raises(UserError, match=words):
        CameraSource(calibrated(tmp_path, bits) if bits else Capture(source=NAME))
    assert nodes.values() == before


def test_exposures_in_turn_are_known_by_their_chunks(plugged, tmp_path):
    """A scene that lies: each frame's picture is that of another exposure than it tells. What it tells counts."""
    exposures, dark = (0.008, 0.0005), np.zeros((4, 8), np.uint16)
    told = [(dark, k, 8000.0, 10**6 * (k + 1)) for k in range(8)] + [(dark + 2000, 8, 8000.0, 10**8), (dark + 100, 9, 500.0, 2 * 10**8)]
    told += [(dark + 100, 10, 8000.0, 3 * 10**8)]
    nodes = camera_nodes()
    plugged(Device(nodes, told))
    settings = calibrated(tmp_path, exposures=exposures, record=str(tmp_path / "out"))
    source = CameraSource(settings)
    got = [source.next(0.0) for _ in told]
    source.close()
    assert [frame is None for frame in got] == [True] * 7 + [False] * 4
    recorded = [read_exr(path)[1]["vemlight:exposure"] for path in sorted((tmp_path / "out").glob("*.exr"))]
    assert [float(exposure) for exposure in recorded] == [0.008, 0.008, 0.0005, 0.008]
    assert {500.0, 8000.0} <= set(nodes.ExposureTime.log)
