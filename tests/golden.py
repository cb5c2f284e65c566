"""Golden messages for readers in any language, and the schema: `make golden` rewrites them, tests compare."""

import json
from pathlib import Path

import msgspec
import numpy as np

from vemlight.light.mask import Mask
from vemlight.light.near_lights import NearLightSet
from vemlight.light.virtual_lamp import VirtualLamp
from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import CHANNELS
from vemlight.runtime.poses import Pose, View
from vemlight.runtime.reports import ImageReport, LevelsReport, LightsReport, MapReport, PointsReport
from vemlight.runtime.wire_schema import schema

PROTO = Path(__file__).parents[1] / "proto"
TABLE_START = "<!-- made by tests/golden.py from services/runtime/channels.py and wire.py -->\n"
TABLE_END = "<!-- end -->"
POWERS = {2**53 - 1: "2^53 - 1", 2**63 - 1: "2^63 - 1"}
VERSION_LINE = "message of wire version 1; this is version 2: install the same vemlight on both sides"
STAMP = stamps.Stamp(sequence=7, time_s=0.28, captured_ns=1_700_000_000_123_456_789, monotonic_ns=5_000_000_001, boot_id="0b00t1d0")


def messages() -> dict[str, wire.Message]:
    """One message of each kind, small enough to read."""
    radiance = (np.arange(2 * 4 * 3, dtype=np.float32) / 8).reshape(2, 4, 3)
    directions = np.array([[0, 0, 1], [0.6, 0, 0.8]], np.float32)
    irradiance = np.array([[1, 0.5, 0.25], [2e6, 0, 1e-3]], np.float32)
    stroke = Mask(points=((0.0, 5.0), (9.0, 5.0)), mode="dark", width_deg=4.0)
    box = Pose(name="box", position=(0.5, -1.0, 0.25), rotation=(0.0, 0.0, 0.6, 0.8))
    lamp = Pose(name="lamp", position=(0.0, 0.0, 2.0), power=0.5)
    drawn = ImageReport(drawn_lights=72, render_ms=12.5, light_budget=144)
    covariances = np.array([[0.1, 0, 0.01, 0.02, 0, 0.001], 6 * [0]], np.float32)
    pixels = np.arange(2 * 3 * 4, dtype=np.uint8).reshape(2, 3, 4)
    status = wire.StatusMessage(
        service="sampler",
        sequence=7,
        rate_hz=25.0,
        age_ms=3.5,
        step_ms=0.75,
        frames=8,
        skipped=1,
        dropped=2,
        refused=0,
        unwritten=4,
        restarts=1,
        step_counts=(3, 4, 1, *10 * (0,)),
        step_total_ms=9.5,
        report=LightsReport(delay_ms=160.0, required_lights=90),
    )
    return {
        "map": (
            wire.MapMessage(
                stamp=STAMP,
                rows=2,
                cols=4,
                coverage="hemisphere",
                luminance_scale=179.0,
                bright_samples=2,
                report=MapReport(invalid_cells=1),
            ),
            (radiance, np.array([5, 5], np.int64), directions, np.array([0.25, 0.75], np.float32)),
        ),
        "lights": (
            wire.LightsMessage(
                stamp=STAMP,
                count=2,
                gloss_count=1,
                coverage="hemisphere",
                report=LightsReport(delay_ms=160.0, delay_frames=4.0, lamp_hz=100.0, flicker_hz=16.0),
            ),
            (np.array([0, 2**40], np.int64), directions, irradiance, directions[:1], irradiance[:1] / 2),
        ),
        "lights_soft": (
            wire.LightsMessage(stamp=STAMP, count=2, coverage="hemisphere", soft=True),
            (np.array([0, 7], np.int64), directions, irradiance, covariances, directions[:0], irradiance[:0]),
        ),
        "lights_none": (
            wire.LightsMessage(stamp=STAMP, count=0, coverage="sphere"),
            (np.zeros(0, np.int64), *4 * [np.zeros((0, 3), np.float32)]),
        ),
        "points": (
            wire.PointsMessage(
                stamp=STAMP, count=2, at=(0.0, 0.25, 1.5), report=PointsReport(cameras=3, near_lights=2, spread_ms=1.5)
            ),
            (
                np.array([3, 2**40], np.int64),
                np.array([[1, 2, 2.5], [-3, 0, 4]], np.float32),
                np.array([[20, 15, 10], [0, 0, 2e3]], np.float32),
                np.array([0.125, 0], np.float32),
                np.array([0.0625, 0.5], np.float32),
            ),
        ),
        "points_none": (wire.PointsMessage(stamp=STAMP, count=0), NearLightSet.empty().arrays()),
        "image": (wire.ImageMessage(stamp=STAMP, width=3, height=2, objects=(box,), report=drawn), (pixels,)),
        "plate": (wire.PlateMessage(stamp=STAMP, width=3, height=2), (pixels[..., :3],)),
        "image_linear": (
            wire.ImageMessage(stamp=STAMP, width=3, height=2, linear=True, tone_scale=0.5, tone_white=1.25),
            (pixels, (np.arange(2 * 3 * 4) / 4).astype(np.float16).reshape(2, 3, 4)),
        ),
        "levels": (
            wire.LevelsMessage(
                stamp=STAMP,
                count=2,
                level_count=3,
                names=("key", "fill"),
                target=(0.0, 0.0, 1.6),
                unmatched_rgb=(0.03, 0.02, 0.05),
                unmatched_at=(0.0, 0.0, -1.0),
                missing_there=0.25,
                text="At full: key.",
                report=LevelsReport(armed=1, unmatched_ratio=0.0625, limited_fixtures=1, solve_ms=0.5, packets=40),
            ),
            (
                np.array([[2, 0, 3], [-2, 0, 3]], np.float32),
                np.array([[0, 0, 1.5], [0, 0, 1.5]], np.float32),
                np.array([1, 2], np.int64),
                np.array([1, 0.25, 0.5], np.float32),
                np.array([[1, 1, 1], [0.5, 0.25, -0.125]], np.float32),
                np.array([1, 0], np.uint8),
            ),
        ),
        "control": (
            wire.ControlMessage(
                count=144, exposure=-0.5, filtered=False, paused=True, armed=True, blackout=False, poses=(box, lamp),
                masks=(Mask(points=((10.0, 20.0), (40.0, 20.0), (25.0, 50.0))), stroke),
                lamps=(VirtualLamp(id=1, azimuth_deg=120.0, elevation_deg=35.0, irradiance=(3.0, 2.5, 2.0)),),
                speed=0.5, loop=False, in_s=0.2, out_s=1.0, seek_number=3, seek_s=0.4,
                camera=View(eye=(0.0, -4.0, 2.0), at=(0.0, 0.0, 1.0), fov_y=35.0),
            ),
            (),
        ),
        "source": (
            wire.SourceMessage(name="bundled sequence", frames=48, fps=24.0, position=7, thumbnails=2),
            (np.array([0, 47]), (np.arange(2 * 48 * 48 * 3) % 251).astype(np.uint8).reshape(2, 48, 48, 3)),
        ),
        "scene": (
            wire.SceneMessage(description_bytes=2, data_bytes=4),  # of no scene that is: flat_scene.py says what the bytes hold
            (np.frombuffer(b"{}", np.uint8), np.arange(4, dtype=np.uint8)),
        ),
        "scene_none": (wire.SceneMessage(description_bytes=0, data_bytes=0, text="too large"), 2 * (np.zeros(0, np.uint8),)),
        "status": (status, ()),
        "end": (wire.EndMessage(sequence=48), ()),
        "request": (wire.RequestMessage(first=12, count=4), ()),
    }


def refused() -> dict[str, list[bytes]]:
    """Messages that a reader must refuse, each damaged in one way."""
    whole = {name: wire.pack(*message) for name, message in messages().items()}
    end = {"kind": "end", "version": 2, "sequence": 1}
    topic, header, radiance, *bright = whole["map"]
    lights, soft, levels, points = whole["lights"], whole["lights_soft"], whole["levels"], whole["points"]
    many = msgspec.to_builtins(messages()["points"][0]) | {"count": 257}
    directions = np.frombuffer(lights[3], "<f4")
    damaged = np.frombuffer(radiance, "<f4").copy()
    damaged[5] = np.nan
    line = {"points": [[0, 1], [2, 3]]}
    same_lamp = {"id": 1, "azimuth_deg": 0, "elevation_deg": 0, "irradiance": [1, 1, 1]}
    huge_scene = {"kind": "scene", "version": 2, "description_bytes": 0, "data_bytes": 2**28}
    nowhere = {"from": [1, 2, 3], "at": [1, 2, 3], "fov_y": 40}
    not_unit = {"name": "box", "position": [0, 0, 0], "rotation": [0, 0, 0, 2]}
    return {
        "no_header": [topic],
        "wrong_topic": [b"lights", header, radiance, *bright],
        "array_missing": [topic, header],
        "array_short": [topic, header, radiance[:-4], *bright],
        "array_long": [topic, header, radiance + b"\0\0\0\0", *bright],
        "array_nan": [topic, header, damaged.tobytes(), *bright],
        "array_too_many": [*whole["end"], b""],
        "header_cut": [topic, header[:-3], radiance, *bright],
        "header_unknown_key": [b"end", msgspec.msgpack.encode(end | {"extra": 0})],
        "header_version_3": [b"end", msgspec.msgpack.encode(end | {"version": 3})],
        "header_nested": [b"end", b"\x84" + msgspec.msgpack.encode(end)[1:] + b"\xa5extra" + 999 * b"\x91" + b"\xc0"],  # a map of 4 keys
        "header_negative": [b"end", msgspec.msgpack.encode(end | {"sequence": -1})],
        "header_huge_side": [topic, msgspec.msgpack.encode(msgspec.to_builtins(messages()["map"][0]) | {"rows": 2**30}), radiance, *bright],
        "bright_outside": [topic, header, radiance, np.array([5, 8], "<i8").tobytes(), *bright[1:]],
        "bright_unordered": [topic, header, radiance, np.array([5, 4], "<i8").tobytes(), *bright[1:]],
        "bright_weight_zero": [topic, header, radiance, *bright[:2], np.array([1, 0], "<f4").tobytes()],
        "lights_not_unit": [*lights[:3], (2 * directions).tobytes(), *lights[4:]],
        "lights_covariance_negative": [*soft[:5], (-np.frombuffer(soft[5], "<f4")).tobytes(), *soft[6:]],
        "lights_covariance_large": [*soft[:5], (20 * np.frombuffer(soft[5], "<f4")).tobytes(), *soft[6:]],
        "lights_negative": [*lights[:4], (-np.frombuffer(lights[4], "<f4")).tobytes(), *lights[5:]],
        "levels_too_high": [*levels[:5], (2 * np.frombuffer(levels[5], "<f4")).tobytes(), *levels[6:]],
        "levels_emitters": [*levels[:4], np.array([1, 1], "<i8").tobytes(), *levels[5:]],
        "points_negative": [*points[:4], (-np.frombuffer(points[4], "<f4")).tobytes(), *points[5:]],
        "points_id_twice": [*points[:2], 2 * points[2][:8], *points[3:]],
        "points_many": [points[0], msgspec.msgpack.encode(many), *(bytes(257 * size) for size in (8, 12, 12, 4, 4))],
        "lamps_of_one_id": [b"control", msgspec.msgpack.encode({"kind": "control", "version": 2, "lamps": [same_lamp, same_lamp]})],
        "mask_of_two_points": [b"control", msgspec.msgpack.encode({"kind": "control", "version": 2, "masks": [line]})],
        "rotation_not_unit": [b"control", msgspec.msgpack.encode({"kind": "control", "version": 2, "poses": [not_unit]})],
        "camera_of_no_length": [b"control", msgspec.msgpack.encode({"kind": "control", "version": 2, "camera": nowhere})],
        "scene_huge": [b"scene", msgspec.msgpack.encode(huge_scene), b"", b""],
        "kind_unknown": [b"sermon", msgspec.msgpack.encode({"kind": "sermon", "version": 2})],
    }


def version_1() -> dict[str, list[bytes]]:
    """Messages of version 1, whose headers said no version and whose fields had other names."""
    whole = {name: wire.pack(*message) for name, message in messages().items()}
    stamp = msgspec.to_builtins(STAMP)
    headers = {
        "map": {"stamp": stamp, "rows": 2, "cols": 4, "coverage": "hemisphere", "strong": 2, "luminance_scale": 179.0, "spoilt": 1},
        "image": {"stamp": stamp, "width": 3, "height": 2, "lights": 72, "render_ms": 12.5, "can": 144, "linear": False, "things": []},
        "end": {"sequence": 48},
        "request": {"first": 12, "count": 4},
    }
    return {kind: [kind.encode(), msgspec.msgpack.encode({"kind": kind, **header}), *whole[kind][2:]] for kind, header in headers.items()}


def vectors() -> dict[str, dict]:
    """The vectors' files: name -> content."""
    files = {}
    for name, (header, arrays) in messages().items():
        described = [{"dtype": a.dtype.str, "shape": list(a.shape), "values": a.ravel().tolist()} for a in arrays]
        parts = [part.hex() for part in wire.pack(header, arrays)]
        files[f"{name}.json"] = {"parts": parts, "header": msgspec.to_builtins(header), "arrays": described}
    for name, parts in refused().items():
        files[f"refused_{name}.json"] = {"parts": [part.hex() for part in parts], "refused": True}
    for kind, parts in version_1().items():
        files[f"refused_version_1_{kind}.json"] = {"parts": [part.hex() for part in parts], "refused": VERSION_LINE}
    return files


def table() -> str:
    """The message kinds and the keys of their headers, for proto/README.md."""
    channels = {channel.kind: (channel.meaning, " or ".join(channel.producers) or "every service") for channel in CHANNELS}
    channels["request"] = "lossless mode: asks for `count` frames from number `first` on", "a consumer"
    rows = ["| kind | content | sender | arrays, in this order |", "|---|---|---|---|"]
    for kind, (meaning, sender) in channels.items():
        arrays = "; ".join(_described(array) for array in wire.KINDS[kind].ARRAYS)
        rows.append(f"| `{kind}` | {meaning} | {sender} | {arrays or 'none'} |")
    definitions = schema()["$defs"]
    kinds = [header.__name__ for header in wire.KINDS.values()]
    rows.append("\nThe keys of their headers; those in brackets may be left out.")
    for name in [*kinds, *sorted(definitions.keys() - kinds)]:
        keys = "; ".join(_key(key, shape, key in definitions[name]["required"]) for key, shape in definitions[name]["properties"].items())
        rows.append(f"\n`{name}`: {keys}.")
    return "\n".join(rows) + "\n"


def _key(key: str, shape: dict, required: bool) -> str:
    """A key of a header as text; one that need not be there stands in brackets."""
    text = f"`{key}` {_type(shape)}"
    return text if required else f"[{text}]"


def _type(shape: dict) -> str:
    if "$ref" in shape:
        return shape["$ref"].rpartition("/")[2]
    if "anyOf" in shape:
        return " or ".join(_type(each) for each in shape["anyOf"])
    if "enum" in shape:
        return " or ".join(map(str, shape["enum"]))
    if shape["type"] == "array":
        counts = sorted({shape["minItems"], shape["maxItems"]}) if "minItems" in shape else [0, shape["maxItems"]]
        each = shape["items"] if shape.get("items") else shape["prefixItems"][0]
        return f"array of {' to '.join(map(str, counts))} x {_type(each)}"
    low, high = shape.get("minimum", shape.get("exclusiveMinimum")), shape.get("maximum", shape.get("exclusiveMaximum"))
    above = "over " if "exclusiveMinimum" in shape else ""
    limits = "" if low is None or high is None else f" {above}{low:g} to {POWERS.get(high, f'{high:g}')}"
    length = f" of {shape.get('minLength', 0)} to {shape['maxLength']} letters" if "maxLength" in shape else ""
    return f"{shape['type']}{limits}{length}"


def _described(array: wire.Array) -> str:
    shape = f"{array.shape[0]}," if len(array.shape) == 1 else ", ".join(map(str, array.shape))
    condition = f", only if `{array.only_if}`" if array.only_if else ""
    return f"`{array.name}` `({shape})` {np.dtype(array.dtype).name}{condition}: {array.meaning}"


def readme(text: str) -> str:
    """The text of proto/README.md with the table as it is now."""
    before, _, rest = text.partition(TABLE_START)
    _, _, after = rest.partition(TABLE_END)
    return f"{before}{TABLE_START}{table()}{TABLE_END}{after}"


def text(content: dict) -> str:
    return json.dumps(content, indent=1) + "\n"


if __name__ == "__main__":
    (PROTO / "vectors").mkdir(parents=True, exist_ok=True)
    (PROTO / "wire.schema.json").write_text(text(schema()))
    (PROTO / "README.md").write_text(readme((PROTO / "README.md").read_text()))
    for name, content in vectors().items():
        (PROTO / "vectors" / name).write_text(text(content))
