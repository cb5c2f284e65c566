"""`vemlight export`: the lights read back from USD, glTF and MCAP by those formats' own formulas are the lights of the file."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.exchange import turned
from tests.support.lights_files import write_lights
from vemlight.commands.cli import main
from vemlight.commands.residual import latlong_from_polar, sources_and_rest
from vemlight.exchange import light_columns
from vemlight.exchange.punctual import angles_deg
from vemlight.exchange.usd_file import DOME_ROTATION_WXYZ, time_codes
from vemlight.exchange.usd_text import DECIMAL, write_decimals
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.images import read_radiance, write_exr
from vemlight.light.light_set import LightSet, lights_row
from vemlight.light.lights_reader import lights_frames
from vemlight.light.sphere import latlong_directions, latlong_solid_angles, map_irradiance

Z = np.array([0.0, 0, 1])
NEEDS = "is not installed: pip install 'vemlight[export,usd]'"


def lights_at(frame: int) -> LightSet:
    """Id 1 is always there, 2 from the second frame on, 3 in the first and fourth, 40 never stands still; one looks straight down."""
    random = np.random.default_rng(frame)
    ids = [1, 40, *([2] if frame else []), *([3] if frame in (0, 3) else [])]
    directions = random.normal(size=(len(ids), 3))
    directions[0] = 0, 0, -1
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    covariances = (across * random.uniform(0, 0.05, (len(ids), 1, 1)))[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return LightSet.of(np.array(ids), directions, random.random((len(ids), 3)) * 10.0 ** random.integers(-3, 4), covariances)


@pytest.fixture
def lights_file(tmp_path: Path) -> Path:
    path = tmp_path / "lights.jsonl"
    write_lights(path, [lights_row(lights_at(k), k + 5, 2 + round(k / 30, 4), "sphere") for k in range(5)])
    return path


def export(*arguments: str | Path) -> str:
    done = CliRunner().invoke(main, ["export", *map(str, arguments)], prog_name="vemlight", catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def check_stage(path: Path, lights_file: Path, intensity: float = 1.0, angle: float = 1.0) -> None:
    """UsdLux: with `normalize` a plane that faces the light gets intensity x 2^exposure x color."""
    usd = pytest.importorskip("pxr.Usd", reason=f"usd-core {NEEDS}")
    lux, geometry = pytest.importorskip("pxr.UsdLux"), pytest.importorskip("pxr.UsdGeom")
    stage = usd.Stage.Open(str(path))
    assert geometry.GetStageUpAxis(stage) == "Z"
    assert geometry.GetStageMetersPerUnit(stage) == 1
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (30, 0, 4)
    assert stage.GetDefaultPrim().GetPath() == "/vemlight"
    stage.SetInterpolationType(usd.InterpolationTypeHeld)
    prims = stage.GetDefaultPrim().GetChildren()
    assert [prim.GetName() for prim in prims] == ["light_0001", "light_0002", "light_0003", "light_0040"]
    for k, frame in enumerate(lights_frames(lights_file)):
        shining = {}
        for prim in prims:
            light = lux.DistantLight(prim)
            assert light.GetNormalizeAttr().Get() is True
            strength = light.GetIntensityAttr().Get(k) * intensity * 2 ** light.GetExposureAttr().Get(k)
            given = strength * np.array(light.GetColorAttr().Get(k))
            if given.any():
                spin = prim.GetAttribute("xformOp:orient").Get(k)
                rotation = np.array([[*spin.GetImaginary(), spin.GetReal()]])
                shining[prim.GetAttribute("vemlight:id").Get()] = given, turned(rotation, Z)[0], light.GetAngleAttr().Get(k) * angle
        assert sorted(shining) == sorted(frame.lights.ids.tolist()), f"frame {k}"
        for number, direction, irradiance, degrees in zip(*frame.lights[:3], angles_deg(frame.lights), strict=True):
            given, towards, width = shining[int(number)]
            assert np.abs(given - irradiance).max() <= 2e-6 * irradiance.max()
            assert np.abs(towards - direction).max() <= 2e-6
            assert width == pytest.approx(degrees, rel=1e-6)


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_a_usd_stage_has_the_lights_of_each_frame(lights_file, tmp_path, suffix):
    pytest.importorskip("pxr", reason=f"usd-core {NEEDS}")
    out = tmp_path / f"out.{suffix}"
    assert export(lights_file, "--usd", out) == f"{out}: 4 lights in 5 frames\n"
    check_stage(out, lights_file)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lights.jsonl", out.name]


@pytest.mark.parametrize("dialect", ["standard", "blender"])
def test_text_and_binary_are_the_same_layer(lights_file, tmp_path, dialect):
    check_same_layer(tmp_path, lights_file, "--usd-dialect", dialect)


def test_text_and_binary_are_the_same_layer_with_a_dome_a_frame(sequence, tmp_path):
    check_same_layer(tmp_path, sequence, "--residual", "--frames", "3", "--count", "8")


def test_text_and_binary_are_the_same_layer_of_one_frame_without_lights(tmp_path):
    write_lights(tmp_path / "dark.json", [lights_row(LightSet.none(), 0, 0.0, "sphere")])
    check_same_layer(tmp_path, tmp_path / "dark.json")


def test_text_and_binary_are_the_same_layer_of_many_lights_that_live_for_a_frame(tmp_path):
    """So that each table has more than 65,536 bytes, ids more than 32 bits and time codes all digits."""
    random = np.random.default_rng(5)

    def lights(k: int) -> LightSet:
        directions = random.normal(size=(400, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return LightSet.of(np.arange(400) + 2**40 + 400 * (k // 2), directions, random.random((400, 3)))

    write_lights(tmp_path / "many.jsonl", [lights_row(lights(k), k, k / 30 + 0.004 * random.random(), "sphere") for k in range(8)])
    check_same_layer(tmp_path, tmp_path / "many.jsonl")


def check_same_layer(folder: Path, *source: str | Path) -> None:
    """As usd-core reads them."""
    sdf = pytest.importorskip("pxr.Sdf", reason=f"usd-core {NEEDS}")
    texts = []
    for suffix in ("usda", "usdc"):
        export(*source, "--usd", folder / f"out.{suffix}")
        texts.append(sdf.Layer.OpenAsAnonymous(str(folder / f"out.{suffix}")).ExportToString())
    assert texts[0] == texts[1]
    assert texts[0].count("def ") > 0


def test_each_light_is_given_whole_with_as_many_more_as_are_wanted_at_once(tmp_path, monkeypatch):
    """Light 3 has more rows than that."""
    monkeypatch.setattr(light_columns, "ROWS_AT_ONCE", 20)
    random = np.random.default_rng(6)
    wanted: dict[int, list[int]] = {}
    with light_columns.LightColumns(tmp_path) as columns:
        for k in range(40):
            ids = np.unique([3, *random.integers(0, 30, 4)])
            columns.add(LightSet.of(ids, np.eye(3)[np.zeros(len(ids), int)], np.outer(ids, [1, 1, 1])), k / 30)
            for number in ids.tolist():
                wanted.setdefault(number, []).append(k)
        blocks = list(columns.lights())
    found = {}
    for block in blocks:
        assert len(block.frames) <= 20 or len(block.ids) == 1
        for number, begin, end in zip(block.ids.tolist(), block.bounds[:-1], block.bounds[1:], strict=True):
            found[number] = block.frames[begin:end].tolist()
            assert (block.irradiance[begin:end] == number).all()
    assert list(found.items()) == sorted(wanted.items())


def test_nine_digits_bring_each_float32_back():
    random = np.random.default_rng(1)
    values = random.integers(0, 2**32, 100_000, dtype=np.uint32).view(np.float32)
    edges = np.array([0, -0.0, 1, 10, 1e9, 999999999, 99999.9999, 1e-45, 1.1754944e-38, 3.4028235e38], np.float32)
    values = np.concatenate([values[np.isfinite(values)], edges])
    written = np.zeros(len(values), DECIMAL)
    write_decimals(written, values)
    texts = [text.tobytes().rstrip(b"\0") for text in written]
    assert {len(text) for text in texts} == {15}
    np.testing.assert_array_equal(np.array([float(text) for text in texts], np.float32).view(np.uint32), values.view(np.uint32))


def test_the_dialect_of_blender_has_a_quarter_of_the_intensity_and_half_the_angle(lights_file, tmp_path):
    """Blender 4.5 takes a strength of 4 x intensity and doubles the angle; the irradiance stands beside them as it is."""
    export(lights_file, "--usd", tmp_path / "out.usda", "--usd-dialect", "blender")
    check_stage(tmp_path / "out.usda", lights_file, intensity=4, angle=2)
    assert b"vemlight:irradiance" in (tmp_path / "out.usda").read_bytes()


def test_a_single_frame_is_a_stage_without_times(tmp_path):
    write_lights(tmp_path / "one.json", [lights_row(lights_at(0), 0, 3.0, "sphere")])
    export(tmp_path / "one.json", "--usd", tmp_path / "out.usda")
    text = (tmp_path / "out.usda").read_text()
    assert "timeSamples" not in text
    assert text.count("def DistantLight") == 3


@pytest.mark.parametrize("rate", [24.0, 25.0, 30000 / 1001, 60.0, 12.3456789])
def test_time_codes_are_frames_also_of_times_with_few_decimals(rate):
    codes, found = time_codes([round(7 + k / rate, 6) for k in range(100)])
    assert found == pytest.approx(rate, rel=1e-4)
    assert np.abs(codes - np.arange(100)).max() < 0.01
    if rate != 12.3456789:
        assert codes.tolist() == list(range(100))
    gap, _ = time_codes([0, 0.04, 0.08, 0.2, 0.24])  # two frames were lost
    assert gap.tolist() == [0, 1, 2, 5, 6]


def gltf_of(path: Path) -> dict:
    data = path.read_bytes()
    if path.suffix == ".gltf":
        return json.loads(data)
    magic, version, length, chunk, kind = struct.unpack_from("<5I", data)
    assert (magic, version, length, kind) == (0x46546C67, 2, len(data), 0x4E4F534A)
    assert chunk == length - 20
    assert chunk % 4 == 0
    return json.loads(data[20:])


@pytest.mark.parametrize("suffix", ["gltf", "glb"])
@pytest.mark.parametrize("frame", [0, 3])
def test_a_gltf_file_has_the_lights_of_the_frame(lights_file, tmp_path, suffix, frame):
    """KHR_lights_punctual: lx on a plane that faces the light, which shines along its node's -Z; glTF is y up."""
    out = tmp_path / f"out.{suffix}"
    export(lights_file, "--gltf", out, "--frame", str(frame))
    document = gltf_of(out)
    assert document["asset"]["version"] == "2.0"
    assert document["extensionsUsed"] == ["KHR_lights_punctual"]
    described = document["extensions"]["KHR_lights_punctual"]["lights"]
    nodes = [document["nodes"][k] for k in document["scenes"][document["scene"]]["nodes"]]
    lights = lights_at(frame)
    assert len(described) == len(lights.ids)
    assert [node["extensions"]["KHR_lights_punctual"]["light"] for node in nodes] == list(range(len(described)))
    for node, light, number, direction, irradiance in zip(nodes, described, *lights[:3], strict=True):
        assert light["type"] == "directional"
        assert all(0 <= channel <= 1 for channel in light["color"])
        assert np.abs(light["intensity"] / 683 * np.array(light["color"]) - irradiance).max() <= 1e-6 * irradiance.max()
        assert np.linalg.norm(node["rotation"]) == pytest.approx(1, abs=1e-6)
        x, y, z = turned(np.array([node["rotation"]]), Z)[0]
        assert np.abs(np.array([x, -z, y]) - direction).max() <= 1e-6
        assert node["extras"]["vemlight"]["id"] == number


def test_a_gltf_file_of_no_lights_has_no_empty_lists(tmp_path):
    """Which the schema refuses."""
    write_lights(tmp_path / "dark.json", [lights_row(LightSet.none(), 0, 0.0, "sphere")])
    export(tmp_path / "dark.json", "--gltf", tmp_path / "dark.gltf")
    assert set(gltf_of(tmp_path / "dark.gltf")) == {"asset", "scene", "scenes"}
    assert "nodes" not in gltf_of(tmp_path / "dark.gltf")["scenes"][0]


def test_an_mcap_recording_has_each_frame_as_it_stands(lights_file, tmp_path):
    reader = pytest.importorskip("mcap.reader", reason=f"mcap {NEEDS}")
    export(lights_file, "--mcap", tmp_path / "out.mcap")
    with open(tmp_path / "out.mcap", "rb") as file:
        messages = list(reader.make_reader(file).iter_messages())
    lines = lights_file.read_bytes().splitlines()
    assert [message.data for *_, message in messages] == lines
    for (schema, channel, message), line in zip(messages, lines, strict=True):
        assert (schema.name, schema.encoding) == ("vemlight.lights/2", "jsonschema")
        assert (channel.topic, channel.message_encoding) == ("/lights", "json")
        assert message.log_time == message.publish_time == round(json.loads(line)["time_s"] * 1e9)
        assert message.sequence == json.loads(line)["sequence"]


def test_a_source_becomes_the_same_lights_as_by_the_command_lights(sequence, tmp_path):
    common = [sequence, "--count", "8", "--points", "--frames", "2"]
    done = CliRunner().invoke(main, ["lights", *map(str, common), "--out", str(tmp_path / "lights.jsonl")])
    assert done.exit_code == 0, done.output
    for source, name in (common, "a"), ([tmp_path / "lights.jsonl"], "b"):
        export(*source, "--usd", tmp_path / f"{name}.usda", "--gltf", tmp_path / f"{name}.gltf")
    for suffix in ("usda", "gltf"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_with_a_luminance_scale_intensities_are_lx(sequence, tmp_path):
    image, _ = read_radiance(sequence / "frame_0000.exr")
    write_exr(tmp_path / "sky.exr", image, {"whiteLuminance": 250.0})
    for name, source in ("plain", sequence / "frame_0000.exr"), ("scaled", tmp_path / "sky.exr"):
        export(source, "--count", "4", "--gltf", tmp_path / f"{name}.gltf", "--usd", tmp_path / f"{name}.usda")
    plain, scaled = ([light["intensity"] for light in gltf_of(tmp_path / f"{name}.gltf")["extensions"]["KHR_lights_punctual"]["lights"]]
                     for name in ("plain", "scaled"))  # fmt: skip
    assert np.allclose(np.array(scaled) / plain, 250 / 683, rtol=1e-9)
    assert '"vemlight:intensity" = "lx"' in (tmp_path / "scaled.usda").read_text()


def test_sources_and_the_rest_have_the_light_of_the_map_in_each_channel():
    random = np.random.default_rng(2)
    radiance = random.uniform(0.5, 1.0, (90, 360, 3)).astype(np.float32)
    radiance[30, 100] = 9000, 8000, 5000
    environment = EnvironmentMap(radiance, "hemisphere")
    total = map_irradiance(radiance, "hemisphere")
    theta, phi = (30.5 * np.pi / 180), 2 * np.pi * 100.5 / 360
    sun = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    in_sun = radiance[30, 100] * np.diff(-np.cos(np.radians([30, 31])))[0] * 2 * np.pi / 360
    lights = LightSet.of(np.array([4, 9]), np.array([sun, [0, 0, 1]]), np.stack([in_sun, total - in_sun]))
    sources, rest = sources_and_rest(lights, environment)
    assert sources.ids.tolist() == [4]
    assert rest.radiance[30, 100].max() < 20
    kept = sources.irradiance.sum(axis=0) + map_irradiance(rest.radiance, rest.coverage)
    assert kept == pytest.approx(total, rel=1e-6)
    image = latlong_from_polar(rest)
    integral = np.einsum("ijc,i->c", image, latlong_solid_angles(*image.shape[:2]), dtype=np.float64)
    assert integral == pytest.approx(map_irradiance(rest.radiance, rest.coverage), rel=1e-6)


def test_the_dome_s_texture_is_turned_to_where_its_light_is(tmp_path, sequence):
    """UsdLux, as OpenEXR's envmap: +Y above, +Z in the centre, +X a quarter from the left."""
    export(sequence / "frame_0000.exr", "--residual", "--usd", tmp_path / "out.usda")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["frame_0000.exr", "out.usda", "out_residual"]
    assert "@./out_residual/frame_0000.exr@" in (tmp_path / "out.usda").read_text()
    w, *axis = DOME_ROTATION_WXYZ
    height, width = 8, 16
    ours = latlong_directions(height, width).reshape(-1, 3)
    theta, u = np.meshgrid((np.arange(height) + 0.5) * np.pi / height, (np.arange(width) + 0.5) / width, indexing="ij")
    x, z = np.sin(theta) * np.sin(2 * np.pi * u), -np.sin(theta) * np.cos(2 * np.pi * u)
    theirs = np.stack([x, np.cos(theta), z], axis=-1).reshape(-1, 3)
    assert np.abs(turned(np.array([[*axis, w]]), theirs) - ours).max() < 1e-12


def test_without_its_package_one_line_names_the_extra(lights_file, tmp_path, monkeypatch):
    for package in ("pxr", "mcap.writer"):
        monkeypatch.setitem(__import__("sys").modules, package, None)
    done = CliRunner().invoke(main, ["export", str(lights_file), "--mcap", str(tmp_path / "out.mcap")])
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("vemlight: --mcap: ")
    assert "pip install 'vemlight[export]'" in line
    assert [path.name for path in tmp_path.iterdir()] == ["lights.jsonl"]
    for name in ("out.usda", "out.usdc"):
        export(lights_file, "--usd", tmp_path / name, "--gltf", tmp_path / "out.gltf")  # need none


def test_a_bad_row_leaves_none_of_the_files(lights_file, tmp_path):
    with open(lights_file, "ab") as file:
        file.write(b"{}\n")
    outputs = ["--usd", str(tmp_path / "o.usda"), "--gltf", str(tmp_path / "o.gltf")]
    done = CliRunner().invoke(main, ["export", str(lights_file), *outputs])
    assert done.exit_code == 2
    assert "lights.jsonl: line 6: " in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["lights.jsonl"]
