"""Images: OpenEXR, Radiance and PNG."""

import struct
import zlib
from pathlib import Path

import numpy as np

from tests.support.hostile.format import Format


def _picture() -> np.ndarray:
    return np.random.default_rng(0).uniform(0, 4, (16, 32, 3)).astype(np.float32)


def _exr_files(folder: Path) -> list[Path]:
    import OpenEXR

    from vemlight.light.images import write_exr

    write_exr(folder / "a.exr", _picture(), {"owner": "somebody"})
    head = {"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File({**head, "comments": "x"}, {name: _picture()[..., 0].astype(np.float16) for name in ("A.R", "A.G", "A.B", "Z")}).write(
        str(folder / "b.exr")
    )
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
    bombs["text"] = (
        b"\x89PNG\r\n\x1a\n"
        + _png_chunk(b"IHDR", head)
        + _png_chunk(b"zTXt", b"a\0\0" + text)
        + _png_chunk(b"IDAT", zlib.compress(bytes(20)))
    )
    return bombs


def _read_radiance(path: Path) -> object:
    from vemlight.light.images import read_radiance

    return read_radiance(path)


def _read_codes(path: Path) -> object:
    from vemlight.light.images import read_codes

    return read_codes(path)


FORMATS = {
    "exr": Format(".exr", _exr_files, _read_radiance, _exr_bombs),
    "hdr": Format(".hdr", _hdr_files, _read_radiance, _hdr_bombs),
    "png": Format(".png", _png_files, _read_codes, _png_bombs),
}
