"""Damaged files and bombs of every format that is read, each read in a child process with limits.

`python -m tests.hostile_files [--count N] [--seed S] [FORMAT ...]`. A file is right or refused with a UserError of one line; a signal, another
exception, a word of a library on the terminal, more than MAX_S or more than MAX_BYTES of memory is a fault, and the file is kept.
"""

import argparse
import os
import random
import resource
import select
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

MAX_S = 5.0
MAX_BYTES = 512 * 2**20  # of a child, all in all: the libraries take 150 to 250 MB of it
BATCH = 200  # mutants a child
WORDS = (b"0", b"-1", b"1e308", b"nan", b"inf", b"99999999999999999999", b"2147483647", b"", b"\0", b"\xff\xfe", b"[" * 3000, b"{" * 3000, b'"' * 99)


class Format(NamedTuple):
    """suffix: of its files. whole: writes sound ones to a folder and returns them. read: what is tried. bombs: name -> content."""

    suffix: str
    whole: Callable[[Path], list[Path]]
    read: Callable[[Path], object]
    bombs: Callable[[], dict[str, bytes]]


# ------------------------------------------------------------------------------------------------------------------------------- images


def _picture() -> np.ndarray:
    return np.random.default_rng(0).uniform(0, 4, (16, 32, 3)).astype(np.float32)


def _exr_files(folder: Path) -> list[Path]:
    import OpenEXR

    from vemlight.light.images import write_exr

    write_exr(folder / "a.exr", _picture(), {"owner": "somebody"})
    head = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File({**head, "comments": "x"}, {name: _picture()[..., 0].astype(np.float16) for name in ("A.R", "A.G", "A.B", "Z")}).write(str(folder / "b.exr"))
    parts = [OpenEXR.Part({**head, "name": name}, {"RGB": _picture()}, name) for name in ("one", "rgba")]
    OpenEXR.File(parts).write(str(folder / "c.exr"))
    return [folder / name for name in ("a.exr", "b.exr", "c.exr")]


def _exr_header(width: int, height: int, more: bytes = b"") -> bytes:
    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value

    channels = b"".join(name + b"\0" + struct.pack("<4i", 2, 0, 1, 1) for name in (b"B", b"G", b"R")) + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    text = b"\x76\x2f\x31\x01" + struct.pack("<I", 2) + attribute("channels", "chlist", channels)
    text += attribute("compression", "compression", b"\3") + attribute("lineOrder", "lineOrder", b"\0")
    text += attribute("dataWindow", "box2i", box) + attribute("displayWindow", "box2i", box)
    text += attribute("pixelAspectRatio", "float", struct.pack("<f", 1)) + attribute("screenWindowWidth", "float", struct.pack("<f", 1))
    return text + attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)) + more + b"\0"


def _exr_bombs() -> dict[str, bytes]:
    sides = ((2**31 - 1, 1), (16384, 16384), (16384, 8192), (8192, 8192), (1, 2**31 - 1), (100_000, 100_000))
    bombs = {f"{width}x{height}": _exr_header(width, height) + bytes(4096) for width, height in sides}
    bombs["many attributes"] = _exr_header(4, 4, b"".join(b"a%d\0int\0\4\0\0\0\0\0\0\0" % k for k in range(100_000)))
    bombs["long attribute"] = _exr_header(4, 4, b"a\0string\0" + struct.pack("<i", 2**31 - 1))
    bombs["empty"], bombs["magic"] = b"", b"\x76\x2f\x31\x01"
    return bombs


def _hdr_files(folder: Path) -> list[Path]:
    codes = np.random.default_rng(0).integers(0, 256, (16, 32, 4), np.uint8)
    head = b"#?RADIANCE\nEXPOSURE=2\nCOLORCORR=1 1 2\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 32\n"
    (folder / "a.hdr").write_bytes(head + codes.tobytes())
    row = bytes([2, 2, 0, 32]) + 4 * bytes([160, 130])
    (folder / "b.hdr").write_bytes(head.replace(b"rgbe", b"xyze") + 16 * row)
    return [folder / "a.hdr", folder / "b.hdr"]


def _hdr_bombs() -> dict[str, bytes]:
    def head(y: int, x: int) -> bytes:
        return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (y, x)

    sides = ((32768, 32768), (10**9, 10**9), (16384, 8192), (1, 2**31), (8192, 8192))
    bombs = {f"{x}x{y}": head(y, x) for y, x in sides}
    run = bytes([200, 200, 200, 130])
    bombs["long runs"] = head(8192, 16384) + 8192 * (run + bytes([1, 1, 1, 255]) + bytes([1, 1, 1, 63]))
    bombs["no end"] = b"#?RADIANCE\n" + b"x" * 10**7
    bombs["many lines"] = b"#?RADIANCE\n" + b"EXPOSURE=1.0001\n" * 10**6
    return bombs


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _png(width: int, height: int, bits: int = 8, colour: int = 2) -> bytes:
    row = 1 + width * bits // 8 * {0: 1, 2: 3, 6: 4}[colour]
    packer, data = zlib.compressobj(9), b""
    for _ in range(height if row * height < 2**32 else 4):
        data += packer.compress(bytes(row))
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _png_chunk(b"IHDR", head) + _png_chunk(b"IDAT", data + packer.flush()) + _png_chunk(b"IEND", b"")


def _png_files(folder: Path) -> list[Path]:
    from vemlight.light.images import write_png

    codes = np.random.default_rng(0).integers(0, 65536, (16, 32, 3), np.uint16)
    write_png(folder / "a.png", codes)
    write_png(folder / "b.png", (codes[..., 0] >> 8).astype(np.uint8))
    return [folder / "a.png", folder / "b.png"]


def _png_bombs() -> dict[str, bytes]:
    bombs = {f"{side}x{side}": _png(side, side) for side in (12_000, 20_000)}
    bombs["30000x30000 gray"] = _png(30_000, 30_000, colour=0)
    for width, height in ((2**31 - 1, 2**31 - 1), (10**6, 1), (1, 10**6), (0, 0)):
        head = struct.pack(">IIBBBBB", width, height, 16, 6, 0, 0, 0)
        bombs[f"{width}x{height}"] = b"\x89PNG\r\n\x1a\n" + _png_chunk(b"IHDR", head) + _png_chunk(b"IDAT", zlib.compress(b"\0" * 100))
    text = zlib.compress(bytes(10**8), 9)
    head = struct.pack(">IIBBBBB", 4, 4, 8, 0, 0, 0, 0)
    bombs["text"] = b"\x89PNG\r\n\x1a\n" + _png_chunk(b"IHDR", head) + _png_chunk(b"zTXt", b"a\0\0" + text) + _png_chunk(b"IDAT", zlib.compress(bytes(20)))
    return bombs


def _read_radiance(path: Path) -> object:
    from vemlight.light.images import read_radiance

    return read_radiance(path)


def _read_codes(path: Path) -> object:
    from vemlight.light.images import read_codes

    return read_codes(path)


# ------------------------------------------------------------------------------------------------------------------------------- meshes


def _textured(folder: Path) -> object:
    import trimesh
    from PIL import Image

    box = trimesh.creation.box()
    image = Image.fromarray(np.random.default_rng(0).integers(0, 256, (8, 8, 3), np.uint8))
    box.visual = trimesh.visual.TextureVisuals(uv=box.vertices[:, :2] + 0.5, image=image)
    return box


def _exported(*suffixes: str) -> Callable[[Path], list[Path]]:
    def whole(folder: Path) -> list[Path]:
        import trimesh

        paths = []
        for k, suffix in enumerate(suffixes):
            mesh = _textured(folder) if suffix in (".glb", ".obj") else trimesh.creation.icosphere(subdivisions=1)
            paths.append(folder / f"mesh{k}{suffix}")
            data = mesh.export(file_type=suffix[1:]) if suffix != ".stl_ascii" else trimesh.creation.box().export(file_type="stl_ascii")
            paths[-1].write_bytes(data.encode() if isinstance(data, str) else data)
        return paths

    return whole


def _gltf_files(folder: Path) -> list[Path]:
    from tests.support.gltf_files import CORNERS, GltfFile

    file = GltfFile()
    file.document["meshes"] = [{"primitives": [{"attributes": {"POSITION": file.accessor(CORNERS)}, "indices": file.accessor(np.arange(3, dtype=np.uint16))}]}]
    file.document["nodes"] = [{"mesh": 0, "rotation": [0.0, 0.0, 0.0, 1.0]}]
    return [file.write(folder / "a.gltf"), file.write(folder / "b.glb"), *_exported(".glb")(folder)]


def _gltf(**document: object) -> bytes:
    import json

    head = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
    return json.dumps({**head, **document}).encode()


def _gltf_bombs() -> dict[str, bytes]:
    triangle = "data:application/octet-stream;base64," + "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"
    view = {"buffers": [{"byteLength": 36, "uri": triangle}], "bufferViews": [{"buffer": 0, "byteLength": 36}]}
    mesh = {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}

    def rows(count: int, **more: object) -> bytes:
        return _gltf(**view, **mesh, accessors=[{"componentType": 5126, "count": count, "type": "VEC3", **more}])

    sound = {**view, **mesh, "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]}
    many = [{"mesh": 0} for _ in range(60_000)]
    deep = [{"children": [k + 1]} for k in range(20_000)] + [{"mesh": 0}]
    bombs = {f"{count} rows without data": rows(count) for count in (49_000_000, 10**12, -1)}
    bombs |= {f"{count} rows of a small buffer": rows(count, bufferView=0) for count in (49_000_000, 10**9)}
    bombs["60,000 nodes"] = _gltf(**{**sound, "nodes": many, "scenes": [{"nodes": list(range(60_000))}]})
    bombs["20,000 generations"] = _gltf(**{**sound, "nodes": deep})
    bombs["a node its own child"] = _gltf(**{**sound, "nodes": [{"children": [0], "mesh": 0}]})
    bombs["doubling"] = _gltf(**{**sound, "nodes": [*({"children": [k + 1, k + 1]} for k in range(40)), {"mesh": 0}]})
    for name in ("/dev/zero", "../../../../../../dev/zero", "file:///dev/zero", "http://127.0.0.1:9/a.bin", "/etc/passwd", "%2e%2e/%2e%2e/etc/passwd"):
        bombs[f"buffer {name}"] = _gltf(**{**sound, "buffers": [{"byteLength": 36, "uri": name}]})
        image = {"images": [{"uri": name}], "textures": [{"source": 0}], "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}
        primitive = {"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 0}, "material": 0}]}
        bombs[f"image {name}"] = _gltf(**{**sound, **image, "meshes": [primitive]})
    bombs["depth"] = b'{"asset": ' + b"[" * 100_000
    bombs["long text"] = _gltf(extras="x" * 10**7)
    return bombs


def _obj_bombs() -> dict[str, bytes]:
    many = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    bombs = {"one face of 100,000 corners": many + b"f" + b" 1 2 3" * 33_333, "index": many + b"f 1 2 99999999999\n", "negative": many + b"f -1 -2 -9\n"}
    for name in (b"/dev/zero", b"../../../../../../dev/zero", b"/etc/passwd"):
        bombs[f"material {name.decode()}"] = b"mtllib " + name + b"\nusemtl a\n" + many + b"f 1 2 3\n"
    bombs["digits"] = b"v " + b"1" * 10**6 + b" 0 0\n"
    bombs["lines"] = b"\n" * 10**7
    bombs["groups"] = many + b"".join(b"g %d\nf 1 2 3\n" % k for k in range(60_000))
    return bombs


def _ply_bombs() -> dict[str, bytes]:
    def head(vertices: int, faces: int, form: bytes = b"binary_little_endian") -> bytes:
        text = b"ply\nformat %s 1.0\nelement vertex %d\nproperty float x\nproperty float y\nproperty float z\n" % (form, vertices)
        return text + b"element face %d\nproperty list uchar int vertex_indices\nend_header\n" % faces

    counts = ((10**9, 1), (10**15, 1), (3, 10**9), (-1, -1))
    bombs = {f"{vertices} vertices, {faces} faces": head(vertices, faces) + bytes(100) for vertices, faces in counts}
    bombs |= {f"ascii {vertices}": head(vertices, 1, b"ascii") for vertices in (10**9, 10**12)}
    bombs["no end"] = b"ply\nformat ascii 1.0\n" + b"comment x\n" * 10**6
    return bombs


def _stl_bombs() -> dict[str, bytes]:
    bombs = {f"{count} triangles": bytes(80) + struct.pack("<I", count) + bytes(50) for count in (2**32 - 1, 10**8, 2)}
    bombs["ascii"] = b"solid a\n" + b"facet normal 0 0 1\nouter loop\n" * 300_000
    return bombs


def _read_mesh(path: Path) -> object:
    scene = path.with_suffix(".toml")
    scene.write_text(f'[camera]\nfrom = [3.0, -4.0, 2.5]\nat = [0.0, 0.0, 0.5]\n[[mesh]]\nfile = "{path.name}"\n')
    from vemlight.renderer.scene.scene import load_scene

    return load_scene(scene)


# --------------------------------------------------------------------------------------------------------------------------- luminaires

IES = b"IESNA:LM-63-2002\n[MANUFAC] me\nTILT=NONE\n1 1000 1 7 1 1 2 0 0 0\n1 1 10\n0 15 30 45 60 75 90\n0\n1000.5 966.4 866.5 707.6 500.5 259.3 0.5\n"
LDT = "Me 1 1 1 0 7 15 R1 Lamp L1 f.ldt today 100 100 50 80 80 0 0 0 0 100 100 1 0 1 1 LED 1000 3000 80 10"
LDT_LINES = (LDT + " 0" * 10 + " 0 0 15 30 45 60 75 90 1000.5 966.4 866.5 707.6 500.5 259.3 0.5").replace(" ", "\n").encode()


def _text_files(**contents: bytes) -> Callable[[Path], list[Path]]:
    def whole(folder: Path) -> list[Path]:
        for name, content in contents.items():
            (folder / name.replace("__", ".")).write_bytes(content)
        return [folder / name.replace("__", ".") for name in contents]

    return whole


def _ray_files(folder: Path) -> list[Path]:
    from tests.support.ray_files import LUMINOUS, ray_file

    rows = np.tile(np.array([0, 0, 0, 0, 0, 1, 1], np.float32), (20, 1))
    spectrum = np.stack([np.arange(400, 700, 50.0), np.ones(6)], axis=-1)
    return [ray_file(folder / "a.tm25ray", rows, LUMINOUS), ray_file(folder / "b.tm25ray", rows, LUMINOUS, spectrum, spectra=1)]


def _ray_bombs() -> dict[str, bytes]:
    from vemlight.renderer.luminaire.rayfile import HEADER

    bombs = {}
    for key, value in (("rays", 2**28), ("rays", 2**63), ("spectra", 2**31 - 1), ("spectra", -1), ("additional_text", 2**31 - 1), ("additional_text", -1)):
        header = np.zeros(1, HEADER)
        header["magic"], header["version"], header["rays"], header["flags"] = b"TM25", 2013, 1, [1, 1, 0, 0, 1, 0, 0, 0]
        header[key] = value
        bombs[f"{key} {value}"] = header.tobytes() + bytes(40_000)
    return bombs


def _read_photometry(path: Path) -> object:
    from vemlight.renderer.luminaire.photometry import read_photometry

    return read_photometry(path)


def _read_rays(path: Path) -> object:
    from vemlight.renderer.luminaire.rayfile import read_rays

    return read_rays(path)


# ----------------------------------------------------------------------------------------------------------------------- settings, tables

TOML_BOMBS = {
    "arrays": b"a = " + b"[" * 100_000, "tables": b"a = " + b"{a=" * 100_000, "dots": b"a" + b".a" * 50_000 + b" = 1\n",
    "dotted table": b"[a" + b".a" * 50_000 + b"]\n", "digits": b"a = " + b"9" * 10**6, "text": b'a = "' + b"x" * 10**7, "BOM": b"\xef\xbb\xbfa = 1\n",
    "latin-1": b'a = "\xfc"\n', "NUL": b"a = 1\0\n", "lines": b"[x]\n" * 300_000, "empty": b"",
}  # fmt: skip


def _settings(path: Path) -> object:
    from vemlight.settings import read_settings

    return read_settings(path)


def _scene(path: Path) -> object:
    from vemlight.renderer.scene.scene import load_scene

    return load_scene(path)


def _lens(path: Path) -> object:
    from vemlight.capture.lens import read_lens

    return read_lens(path)


def _response(path: Path) -> object:
    from vemlight.capture.response import read_response

    return read_response(path)


def _patches(path: Path) -> object:
    from vemlight.capture.calibration.response_fit import read_patches

    return read_patches(path)


def _manifest(path: Path) -> object:
    from vemlight.capture.sequence import read_manifest

    return read_manifest(path.parent)


SCENE = b'[camera]\nfrom = [3.0, -4.0, 2.5]\nat = [0.0, 0.0, 0.5]\n[[mesh]]\nshape = "sphere"\nscale = 0.5\nat = [0.0, 0.0, 0.5]\nmaterial = {diffuse = [0.6, 0.5, 0.4]}\n'
LENS = b"size = [160, 160]\nf = [48.5, 48.5]\nc = [79.5, 79.5]\nk1 = -0.012\nk2 = 0.0\nk3 = 0.0\nk4 = 0.0\nrim_deg = 93.0\nvignetting = [-0.04]\n"
RESPONSE = b'kind = "linear"\nbits = 12\nblack = 64.0\ngain = 1000.0\n'
PATCHES = b"code,luminance,use\n100,1.5,fit\n300,10,fit\n500,80,check\n700,500,fit\n900,3000,fit\n"
LINE = b'{"name":"a.exr","sequence":0,"time_s":0.0,"sha256":"' + b"0" * 64 + b'"}\n'
JSON_BOMBS = {
    "arrays": b"[" * 100_000, "objects": b'{"a":' * 100_000, "lines": LINE * 100_000, "digits": LINE.replace(b"0.0", b"9" * 10**6),
    "path": LINE.replace(b"a.exr", b"../a.exr"), "empty": b"", "NUL": bytes(4096),
}  # fmt: skip
CSV_BOMBS = {"quotes": b'"' * 10**6, "columns": b"code,luminance,use\n" + b"," * 10**6, "rows": PATCHES + b"1,1,fit\n" * 10**6, "NUL": bytes(1000), "empty": b""}

FORMATS: dict[str, Format] = {
    "exr": Format(".exr", _exr_files, _read_radiance, _exr_bombs),
    "hdr": Format(".hdr", _hdr_files, _read_radiance, _hdr_bombs),
    "png": Format(".png", _png_files, _read_codes, _png_bombs),
    "gltf": Format(".gltf", _gltf_files, _read_mesh, _gltf_bombs),
    "obj": Format(".obj", _exported(".obj"), _read_mesh, _obj_bombs),
    "ply": Format(".ply", _exported(".ply"), _read_mesh, _ply_bombs),
    "stl": Format(".stl", _exported(".stl"), _read_mesh, _stl_bombs),
    "ies": Format(".ies", _text_files(a__ies=IES), _read_photometry, lambda: {"angles": IES.replace(b" 7 1 1", b" 999999999 999999999 1"), "empty": b""}),
    "ldt": Format(".ldt", _text_files(a__ldt=LDT_LINES), _read_photometry, lambda: {"planes": LDT_LINES.replace(b"\n7\n", b"\n999999999\n"), "empty": b""}),
    "tm25": Format(".tm25ray", _ray_files, _read_rays, _ray_bombs),
    "settings": Format(".toml", _text_files(a__toml=b'mode = "live"\n[capture]\nfps = 20.0\n[sampler]\ncount = 9\n'), _settings, lambda: TOML_BOMBS),
    "scene": Format(".toml", _text_files(a__toml=SCENE), _scene, lambda: TOML_BOMBS),
    "lens": Format(".toml", _text_files(a__toml=LENS), _lens, lambda: TOML_BOMBS),
    "response": Format(".toml", _text_files(a__toml=RESPONSE), _response, lambda: TOML_BOMBS),
    "patches": Format(".csv", _text_files(a__csv=PATCHES), _patches, lambda: CSV_BOMBS),
    "manifest": Format(".jsonl", _text_files(manifest__jsonl=LINE * 3), _manifest, lambda: JSON_BOMBS),
}


def mutant(content: bytes, other: bytes, chance: random.Random) -> bytes:
    """Bytes changed, cut, doubled, spliced with another file's, or numbers replaced by others that a reader may trip over."""
    data = bytearray(content)
    match chance.randrange(6):
        case 0 | 1:
            for _ in range(chance.randint(1, 8)):
                data[chance.randrange(len(data))] = chance.randrange(256)
        case 2:
            del data[chance.randrange(len(data)) :]
        case 3:
            at, length = chance.randrange(len(data)), chance.randint(1, 200)
            data[at:at] = data[at : at + length] * chance.choice((1, 2, 50))
        case 4:
            data[chance.randrange(len(data)) :] = other[chance.randrange(len(other)) :]
        case _:
            at = chance.randrange(len(data))
            data[at : at + chance.randint(0, 12)] = chance.choice(WORDS) if chance.random() < 0.7 else struct.pack("<I", chance.choice((0, 1, 2**31, 2**32 - 1)))
    return bytes(data)


class Fault(NamedTuple):
    """What a file did that it may not: the file is kept at `path`."""

    format: str
    name: str
    reason: str


def _child(format: Format, folder: Path, contents: list[tuple[str, bytes]], report: int) -> None:
    """Reads the files one after the other and says of each, on `report`, what came of it."""
    words = os.open(folder / "words", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    os.dup2(words, 1)
    os.dup2(words, 2)
    from vemlight.errors import UserError

    for number, (_, content) in enumerate(contents):
        path = folder / ("manifest.jsonl" if format.suffix == ".jsonl" else f"file{format.suffix}")
        path.write_bytes(content)
        before, fault = os.fstat(words).st_size, ""
        try:
            format.read(path)
        except UserError as error:
            fault = "" if "\n" not in str(error) and str(error) else f"its line is {str(error)!r}"
        except BaseException as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            fault = f"{type(error).__name__}: {' '.join(str(error).split())[:200]} at {Path(where.filename).name}:{where.lineno}"
        os.lseek(words, before, os.SEEK_SET)
        said = [line for line in os.read(words, 4096).splitlines() if not line.startswith(b"vemlight: ")]
        fault = fault or (f"a library said {said[0][:200]!r}" if said else "")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        os.write(report, f"{number}\t{peak}\t{fault}\n".encode())


def _batch(name: str, format: Format, folder: Path, contents: list[tuple[str, bytes]], keep: Path) -> list[Fault]:
    """Reads all contents, in as many children as it takes: one that ends or hangs costs its file and nothing else."""
    faults: list[Fault] = []
    at = 0

    def fault(number: int, reason: str) -> None:
        keep.mkdir(parents=True, exist_ok=True)
        path = keep / f"{name}-{len(list(keep.iterdir()))}{format.suffix}"
        path.write_bytes(contents[number][1])
        faults.append(Fault(name, f"{contents[number][0]} ({path})", reason))

    while at < len(contents):
        reader, report = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reader)
            try:
                _child(format, folder, contents[at:], report)
            finally:
                os._exit(0)
        os.close(report)
        done, buffered, peak, hung = at, b"", 0, False
        while True:
            ready, _, _ = select.select([reader], [], [], MAX_S)
            data = os.read(reader, 65536) if ready else b""
            if not ready:
                hung = True
                os.kill(child, signal.SIGKILL)
            buffered += data
            *lines, buffered = buffered.split(b"\n")
            for line in lines:
                number, before_bytes, reason = line.decode(errors="replace").split("\t", 2)
                grew = int(before_bytes) > MAX_BYTES >= peak
                peak = max(peak, int(before_bytes))
                done = at + int(number) + 1
                if reason or grew:
                    fault(done - 1, reason or f"{peak / 2**20:.0f} MB")
            if not data:
                break
        os.close(reader)
        _, status = os.waitpid(child, 0)
        if hung or os.WIFSIGNALED(status):
            fault(done, f"more than {MAX_S:g} s" if hung else f"killed by {signal.Signals(os.WTERMSIG(status)).name}")
            done += 1
        elif done < len(contents):
            fault(done, "the child ended")
            done += 1
        at = done
    return faults


def examine(name: str, count: int, seed: int, keep: Path) -> list[Fault]:
    """`count` mutants and all bombs of a format; the faulty ones are kept in `keep`."""
    format, chance = FORMATS[name], random.Random(f"{name} {seed}")
    folder = Path(tempfile.mkdtemp(prefix="vemlight-hostile-"))
    try:
        whole = [path.read_bytes() for path in format.whole(folder)]
        faults = []
        for content in [*whole, *format.bombs().values()]:  # first what must be right, which also loads the libraries
            del content
        sound = _batch(name, format, folder, [(f"sound file {k}", content) for k, content in enumerate(whole)], keep)
        faults += sound
        for bomb, content in format.bombs().items():  # each in its own child: memory is the child's
            faults += _batch(name, format, folder, [(f"bomb {bomb}", content)], keep)
        for start in range(0, count, BATCH):
            contents = [(f"mutant {start + k}", mutant(chance.choice(whole), chance.choice(whole), chance)) for k in range(min(BATCH, count - start))]
            faults += _batch(name, format, folder, contents, keep)
        return faults
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=f"of {', '.join(FORMATS)}; left out: all")
    parser.add_argument("--count", type=lambda text: int(float(text)), default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "vemlight-hostile", help="folder for the faulty files")
    options = parser.parse_args()
    found = 0
    for name in options.formats or FORMATS:
        began_s = time.monotonic()
        faults = examine(name, options.count, options.seed, options.keep)
        found += len(faults)
        print(f"{name}: {options.count} mutants, {len(faults)} faults, {time.monotonic() - began_s:.0f} s", flush=True)
        for kind in dict.fromkeys(fault.reason for fault in faults):
            some = [fault for fault in faults if fault.reason == kind]
            print(f"  {len(some)} x {kind}: {some[0].name}", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
