"""What long recordings and rigs of cameras leave on disk: rig files, plans, maps and states of archives, saved settings, dropped scenes."""

import hashlib
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np

from tests.support.hostile.format import Format
from tests.support.hostile.tables import text_files, toml_bombs

RIG = b"""pose_deg = 0.05
pose_m = 0.002
[[camera]]
name = "left"
source = "left"
lens = "left.toml"
at = [-0.5, 0.0, 1.2]
[[camera]]
name = "right"
source = "right"
at = [0.5, 0.0, 1.2]
turn = [0.0, 0.0, 0.6, 0.8]
gain = [1.0, 1.1, 0.9]
"""
HEAD = struct.Struct("<II")  # of a record in a file of maps: the length of its msgpack, its CRC-32


def _rig_bombs() -> dict[str, bytes]:
    one = RIG[RIG.index(b"[[camera]]") : RIG.index(b'[[camera]]\nname = "right"')]
    cameras = {
        f"{count} cameras": b"".join(one.replace(b"left", b"c%d" % k).replace(b"-0.5", b"%d.5" % k) for k in range(count))
        for count in (1, 16, 17, 5000)
    }
    numbers = {
        f"{name} {value.decode()}": RIG.replace(b"-0.5", value) if name == "at" else RIG.replace(b"0.6, 0.8", value + b", 0.8")
        for name in ("at", "turn")
        for value in (b"nan", b"inf", b"1e308", b"-1e5", b"9" * 400, b'"x"', b"[]")
    }
    names = {name[:20]: RIG.replace(b'"left"', b'"' + name + b'"', 1) for name in (b"", b"..", b"a/b", b"A", b"a" * 33, b"right")}
    sources = {name[:20]: RIG.replace(b'"right"\nat', b'"' + name + b'"\nat') for name in (b"", b"\\u0000", b"x" * 5000, b"..")}
    named = {f"{key} {name!r}": file for key, files in (("name", names), ("source", sources)) for name, file in files.items()}
    return {**toml_bombs(RIG), **cameras, **numbers, **named}


def _rig(path: Path) -> object:
    from vemlight.fuse.rig_file import read_camera_rig

    return read_camera_rig(path)


def _plan_files(folder: Path) -> list[Path]:
    from vemlight.commands.archive.archiving import archive
    from vemlight.commands.options import ArchiveOptions
    from vemlight.light.images import write_exr

    (folder / "frames").mkdir()
    for k in range(2):
        write_exr(folder / "frames" / f"f_{k}.exr", np.full((8, 16, 3), 1 + k, np.float32))
    archive(ArchiveOptions(source=folder / "frames", out=folder / "a", workers=1, maps_only=True))
    return [folder / "a" / "plan.json"]


def _plan(path: Path) -> object:
    from vemlight.commands.archive.plan import found_plan

    path.replace(path.parent / "plan.json")
    return found_plan(path.parent)


def _plan_bombs() -> dict[str, bytes]:
    return {
        "arrays": b"[" * 100_000, "objects": b'{"a":' * 100_000, "empty": b"", "2 MB": b" " * 2_000_000,
        "digits": b'{"frames":' + b"9" * 10**5 + b"}", "exponent": b'{"frames":1e999999}', "null": b"null",
    }  # fmt: skip


def _map_files(folder: Path) -> list[Path]:
    from vemlight.capture.frames import Frame
    from vemlight.commands.archive.map_file import ChunkHeader, write_maps
    from vemlight.light.bright_cells import BrightCells

    cells = BrightCells(np.array([3, 7]), np.array([[0, 0, 1], [0.6, 0, 0.8]], np.float32), np.array([0.5, 1], np.float32))
    for name, count in (("a", 1), ("b", 3)):
        frames = (
            Frame(np.full((4, 8, 3), k, np.float32), "hemisphere", k / 25, None, 0, 0, cells, clipped=False) for k in range(count)
        )
        with open(folder / name, "wb") as file:
            write_maps(file, ChunkHeader("0" * 64, 0, count, "1" * 64, "hemisphere"), frames)
    return [folder / "a", folder / "b"]


def _maps(path: Path) -> object:
    from vemlight.commands.archive.map_file import MapReader
    from vemlight.errors import UserError

    with open(path, "rb") as file:
        try:
            return sum(float(frame.radiance.sum()) for frame in MapReader(file).frames())
        except UserError:
            raise
        except ValueError as error:  # the archive's own words follow
            raise UserError(f"{path}: {error}; make it again") from error


def _with_checks(content: bytes) -> bytes:
    """A file of maps whose records' CRCs are right as far as their lengths can be followed."""
    import msgspec

    from vemlight.commands.archive.map_file import MAGIC

    data, at, nbytes = bytearray(content), len(MAGIC), 0
    while at + HEAD.size <= len(data):
        length, _ = HEAD.unpack_from(data, at)
        record = bytes(data[at + HEAD.size : at + HEAD.size + length])
        try:
            values = msgspec.msgpack.decode(record)
            numbers = values[2:] if at > len(MAGIC) else (0, 0, 0)
            nbytes = 12 * numbers[0] * numbers[1] + 24 * numbers[2]
            end = at + HEAD.size + length + nbytes
            HEAD.pack_into(data, at, length, zlib.crc32(data[at + HEAD.size : end]))
        except (ValueError, TypeError, IndexError, RecursionError, OverflowError, MemoryError):
            break
        if not nbytes >= 0 or end > len(data):
            break
        at = end
    return bytes(data)


def _map_bombs() -> dict[str, bytes]:
    import msgspec

    from vemlight.commands.archive.map_file import MAGIC

    def record(values: object) -> bytes:
        content = msgspec.msgpack.encode(values)
        return HEAD.pack(len(content), zlib.crc32(content)) + content

    def chunk(frames: int) -> bytes:
        return MAGIC + record(["0" * 64, 0, frames, "1" * 64, "hemisphere"])

    nested = 900 * b"\x91" + b"\xc0"
    return {
        "8192 x 8192": chunk(1) + record([0.0, False, 8192, 8192, 0]),
        "many samples": chunk(1) + record([0.0, False, 1, 1, 4096]),
        "more samples": chunk(1) + record([0.0, False, 1, 1, 4097]),
        "10^15 frames": chunk(10**15) + record([0.0, False, 1, 1, 0]) + bytes(12),
        "2^63 frames": MAGIC + record(["", 0, 2**63, "", "hemisphere"]),
        "a long record": MAGIC + HEAD.pack(2**32 - 1, 0),
        "nested": MAGIC + HEAD.pack(len(nested), zlib.crc32(nested)) + nested,
        "nan": chunk(1) + record([float("nan"), False, 1, 1, 0]) + bytes(12),
        "empty": b"", "magic": MAGIC,
    }  # fmt: skip


def _state_files(folder: Path) -> list[Path]:
    from vemlight.capture.frames import Frame
    from vemlight.commands.archive.folder import ArchiveState
    from vemlight.commands.lighting import first_state, lit_frame
    from vemlight.light.bright_cells import NO_BRIGHT_CELLS
    from vemlight.sampler.snapshot import encoded
    from vemlight.settings import Sampler

    state = first_state()
    for k in range(3):
        frame = Frame(np.full((6, 12, 3), 1 + k, np.float32), "hemisphere", k / 25, None, 0, 0, NO_BRIGHT_CELLS, clipped=False)
        state, _ = lit_frame(Sampler(count=8), state, frame)
    path = folder / "state"
    path.write_bytes(encoded(ArchiveState("0" * 64, (b"x" * 32,), ("f",), state)))
    return [path]


def _state(path: Path) -> object:
    from vemlight.commands.archive.folder import ArchiveState
    from vemlight.errors import UserError
    from vemlight.sampler.snapshot import decoded

    try:
        return decoded(path.read_bytes(), ArchiveState)
    except ValueError as error:  # the archive takes the state before it
        raise UserError(f"{path}: is damaged; it is made again") from error


def _with_digest(content: bytes) -> bytes:
    return hashlib.sha256(content[32:]).digest() + content[32:]


def _saved_files(folder: Path) -> list[Path]:
    from vemlight.light.mask import Mask
    from vemlight.light.virtual_lamp import VirtualLamp
    from vemlight.runtime.poses import Pose
    from vemlight.runtime.wire import ControlMessage
    from vemlight.settings import Settings
    from vemlight.viewer.saved_settings import settings_file

    control = ControlMessage(
        count=30, exposure=0.5, filtered=False, speed=2.0, source="bundled",
        poses=(Pose(name="box", position=(0.5, 0.0, 0.25), rotation=(0.0, 0.0, 0.6, 0.8)),),
        masks=(Mask(points=((10.0, 20.0), (40.0, 20.0), (25.0, 50.0))), Mask(points=((0.0, 5.0),), mode="dark", width_deg=4.0)),
        lamps=(VirtualLamp(id=1, azimuth_deg=120.0, elevation_deg=35.0, irradiance=(3.0, 2.5, 2.0)),),
    )  # fmt: skip
    (folder / "saved.toml").write_bytes(settings_file(Settings(), control))
    return [folder / "saved.toml"]


def _saved_bombs() -> dict[str, bytes]:
    mask = b"[[capture.masks]]\npoints = [[0, 0], [9, 0], [9, 9]]\n"
    lamp = b"[[sampler.lamp]]\nid = 1\nazimuth_deg = 0\nelevation_deg = 0\nirradiance = [1, 1, 1]\n"
    return {
        **{f"{count} masks": mask * count for count in (16, 17, 20_000)},
        **{f"mask of {count} points": b"[[capture.masks]]\npoints = [" + b"[0, 0]," * count + b"]\n" for count in (0, 1, 64, 65, 10**5)},
        **{f"mask at {value.decode()}": mask.replace(b"9", value) for value in (b"nan", b"inf", b"1e308", b"361", b"[]")},
        **{f"{count} lamps": lamp * count for count in (2, 17, 9000)},
        **{f"lamp of {value.decode()}": lamp.replace(b"[1, 1", b"[1, " + value) for value in (b"nan", b"-1", b"1e13", b"1e308")},
    }  # fmt: skip


def _saved(path: Path) -> object:
    from vemlight.capture.masking import mask_weights
    from vemlight.light.virtual_lamp import lights_of_lamps
    from vemlight.settings_file import read_settings

    settings = read_settings(path)
    return mask_weights(settings.capture.masks, 30, 60, "hemisphere"), lights_of_lamps(settings.sampler.lamp)


def _glb(folder: Path, corners: np.ndarray) -> Path:
    from tests.support.gltf_files import GltfFile

    file = GltfFile(nodes=[{"mesh": 0}])
    file.document["meshes"] = [{"primitives": [{"attributes": {"POSITION": file.accessor(corners)}}]}]
    return file.write(folder / "a.glb")


def _dropped_files(folder: Path) -> list[Path]:
    from tests.support.gltf_files import TRIANGLE

    return [_glb(folder, TRIANGLE)]


def _dropped_bombs() -> dict[str, bytes]:
    from tests.support.gltf_files import TRIANGLE

    sizes = {"nan": np.nan, "inf": np.inf, "huge": 3e38, "large": 1e30, "tiny": 1e-40, "at one place": 0.0}
    with tempfile.TemporaryDirectory() as folder, np.errstate(all="ignore"):
        bombs = {name: _glb(Path(folder), TRIANGLE * np.float32(size)).read_bytes() for name, size in sizes.items()}
        bombs["far away"] = _glb(Path(folder), TRIANGLE + np.float32(1e30)).read_bytes()
    head = struct.pack("<4sII", b"glTF", 2, 12)
    return {**bombs, "empty": b"", "head": head, "lengths": struct.pack("<4sIIII", b"glTF", 2, 2**32 - 1, 2**32 - 1, 0x4E4F534A)}


def _dropped(path: Path) -> object:
    from vemlight.renderer.scene.upload_check import check

    folder = path.parent / "dropped"
    folder.mkdir(exist_ok=True)
    path.replace(folder / "file.glb")
    return check(folder)


FORMATS = {
    "rig": Format(".toml", text_files(a__toml=RIG), _rig, _rig_bombs),
    "plan": Format(".json", _plan_files, _plan, _plan_bombs, share=0.5),
    "maps": Format(".maps", _map_files, _maps, _map_bombs, _with_checks),
    "state": Format(".state", _state_files, _state, lambda: {"empty": b"", "digest": bytes(32)}, _with_digest),
    "saved": Format(".toml", _saved_files, _saved, _saved_bombs),
    "dropped": Format(".glb", _dropped_files, _dropped, _dropped_bombs, share=0.5),
}
