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
    bombs |= {
        f"{count} channels {side}": _exr_chain(count, side, side) + bytes(4096)
        for count, side in ((1000, 1024), (1000, 2048), (10_000, 512), (100_000, 16), (4, 2048), (40, 1024))
    }
    tiled = bytearray(_exr_header(2048, 2048, b"tiles\0tiledesc\0" + struct.pack("<iIIB", 9, 2**31 - 1, 2**31 - 1, 0)))
    tiled[5] = 2  # the flag for tiles
    bombs["huge tiles"] = bytes(tiled) + bytes(4096)
    mip = bytearray(_exr_header(2048, 2048, b"tiles\0tiledesc\0" + struct.pack("<iIIB", 9, 1, 1, 2)))
    mip[5] = 2
    bombs["tiles of a pixel, all levels"] = bytes(mip) + bytes(4096)
    for side in (4, 4096):
        part = _exr_header(side, side)[8:]
        for count in (100, 1000, 20_000):
            parts = bytearray(b"\x76\x2f\x31\x01" + struct.pack("<I", 2 | 0x1000) + part * count + b"\0")
            bombs[f"{count} parts of {side}"] = bytes(parts) + bytes(4096)
    bombs["negative window"] = _exr_header(-5, -5)
    bombs["no channels"] = _exr_chain(0, 16, 16) + bytes(4096)
    bombs["unknown compression"] = _exr_header(16, 16).replace(
        b"compression\0compression\0\1\0\0\0\3", b"compression\0compression\0\1\0\0\0\x63"
    )
    bombs["an attribute of an endless name"] = _exr_header(16, 16)[:-1] + b"x" * 10**6
    for place in (2**31 - 1, -(2**31)):
        box = b"displayWindow\0box2i\0" + struct.pack("<5i", 16, place - 8 if place > 0 else place, 0, place if place > 0 else place + 8, 9)
        bombs[f"display window at {place}"] = (
            _exr_header(16, 16).replace(b"displayWindow", b"displayWindo_")[:-1] + box + b"\0" + bytes(999)
        )
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
    more = ((16384, 16384), (16385, 1), (1, 16385), (0, 9), (10**18, 1), (4096, 4096), (16384, 4), (4, 16384), (8, 10**7), (7, 10**7))
    bombs |= {f"{x}x{y}": head(y, x) + bytes(4 * 16384) for x, y in more}
    row = bytes([2, 2, 64, 0]) + 4 * (128 * bytes([255, 130]) + bytes([130, 1]))
    bombs |= {
        f"runs {x}x{y}": head(y, x) + bytes([2, 2, x >> 8, x & 255]) + 4 * (x // 127) * bytes([255, 9])
        for x, y in ((16384, 8192), (16384, 1024), (8192, 4096), (127, 16384))
    }
    bombs["rows cut"] = head(8192, 16384) + row * 8000
    bombs["exposures"] = b"#?RADIANCE\n" + b"EXPOSURE=1e30\n" * 4000 + b"\n-Y 4 +X 4\n" + bytes(64)
    bombs["primaries"] = b"#?RADIANCE\nPRIMARIES=1 1 1 1 1 1 1 1\n\n-Y 4 +X 4\n" + bytes(64)
    bombs["digits"] = b"#?RADIANCE\n\n-Y " + b"9" * 60_000 + b" +X 4\n"
    bombs["numbers"] = b"#?RADIANCE\nEXPOSURE=" + b"1" * 60_000 + b"\n\n-Y 4 +X 4\n" + bytes(64)
    bombs["tiny exposure"] = b"#?RADIANCE\nEXPOSURE=1e-300\n\n-Y 4 +X 4\n" + bytes(range(64))
    bombs["empty"], bombs["NUL"] = b"", bytes(10**6)
    bombs["no end"] = b"#?RADIANCE\n" + b"x" * 10**7
    bombs["many lines"] = b"#?RADIANCE\n" + b"EXPOSURE=1.0001\n" * 10**6
    return bombs


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, bits: int = 8, colour: int = 2) -> bytes:
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
    bombs = {f"{side}x{side}": png(side, side) for side in (12_000, 20_000)}
    bombs["30000x30000 gray"] = png(30_000, 30_000, colour=0)
    for width, height in ((2**31 - 1, 2**31 - 1), (10**6, 1), (1, 10**6), (0, 0)):
        head = struct.pack(">IIBBBBB", width, height, 16, 6, 0, 0, 0)
        bombs[f"{width}x{height}"] = b"\x89PNG\r\n\x1a\n" + _png_chunk(b"IHDR", head) + _png_chunk(b"IDAT", zlib.compress(b"\0" * 100))
    for width, height, bits, colour in (
        (16384, 16384, 16, 6),
        (16384, 8192, 1, 0),
        (16384, 8192, 16, 2),
        (8192, 8192, 8, 3),
        (4, 2**31, 8, 0),
    ):
        head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 1)
        bombs[f"interlaced {width}x{height}, {bits}, {colour}"] = (
            b"\x89PNG\r\n\x1a\n" + _png_chunk(b"IHDR", head) + _png_chunk(b"IDAT", zlib.compress(bytes(10**7), 9))
        )
    small = png(4, 4)
    bombs |= {
        f"{kind.decode()} of {size}": small[:33] + struct.pack(">I", size) + kind + bytes(100) + small[33:]
        for kind in (b"tEXt", b"iCCP", b"PLTE", b"eXIf")
        for size in (2**31 - 1, 2**32 - 1, 100)
    }
    for kind, start in ((b"iCCP", b"a\0\0"), (b"iTXt", b"a\0\1\0\0\0")):
        bombs[f"{kind.decode()} bomb"] = small[:33] + _png_chunk(kind, start + zlib.compress(bytes(10**8), 9)) + small[33:]
    bombs["many chunks"] = small[:33] + _png_chunk(b"tEXt", b"a\0b") * 300_000 + small[33:]
    bombs["empty"], bombs["signature"] = b"", small[:8]
    text = zlib.compress(bytes(10**8), 9)
    head = struct.pack(">IIBBBBB", 4, 4, 8, 0, 0, 0, 0)
    bombs["text"] = (
        b"\x89PNG\r\n\x1a\n"
        + _png_chunk(b"IHDR", head)
        + _png_chunk(b"zTXt", b"a\0\0" + text)
        + _png_chunk(b"IDAT", zlib.compress(bytes(20)))
    )
    return bombs


def _exr_chain(count: int, width: int, height: int) -> bytes:
    """The header of an EXR with so many channels."""
    channels = b"".join(b"c%d\0" % k + struct.pack("<4i", 2, 0, 1, 1) for k in range(count)) + b"\0"
    plain = _exr_header(width, height)
    begin = plain.index(b"channels\0chlist\0")
    end = plain.index(b"compression\0")
    return plain[:begin] + b"channels\0chlist\0" + struct.pack("<i", len(channels)) + channels + plain[end:]


def _photo_files(folder: Path) -> list[Path]:
    from PIL import Image

    picture = Image.fromarray(np.random.default_rng(0).integers(0, 256, (16, 32, 3), np.uint8))
    options = {"a.jpg": {}, "b.jpg": {"progressive": True}, "c.tif": {"compression": "tiff_lzw"}, "d.tif": {"compression": "tiff_deflate"}}
    for name, more in options.items():
        picture.save(folder / name, **more)
    return [folder / name for name in options]


def _tiff(width: int, height: int, compression: int = 1, data: bytes = bytes(100), **more: int) -> bytes:
    tags = {256: width, 257: height, 258: 8, 259: compression, 262: 1, 273: 8, 277: 1, 278: height, 279: len(data)}
    tags |= {int(key.removeprefix("tag")): value for key, value in more.items()}
    rows = b"".join(struct.pack("<HHII", tag, 4, 1, value % 2**32) for tag, value in sorted(tags.items()))
    return b"II*\0" + struct.pack("<I", 8 + len(data)) + data + struct.pack("<H", len(tags)) + rows + bytes(4)


def _jpeg(width: int, height: int, components: int = 1, progressive: bool = False) -> bytes:
    from io import BytesIO

    from PIL import Image

    small = BytesIO()
    Image.new("L" if components == 1 else "RGB", (16, 16)).save(small, "JPEG", progressive=progressive)
    data = bytearray(small.getvalue())
    at = data.index(b"\xff\xc2" if progressive else b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    return bytes(data)


def _photo_bombs() -> dict[str, bytes]:
    sides = ((65535, 65535), (65500, 65500), (16384, 16384), (16384, 8192), (10_000, 10_000), (65535, 1), (1, 65535), (0, 16))
    bombs = {f"JPEG {w}x{h}": _jpeg(w, h) for w, h in sides}
    bombs |= {f"progressive JPEG {w}x{h}": _jpeg(w, h, 3, progressive=True) for w, h in sides}
    tiffs = (*sides, (2**31, 2**31), (2**32 - 1, 1), (20_000, 20_000))
    bombs |= {f"TIFF {w}x{h}": _tiff(w, h) for w, h in tiffs}
    bombs |= {f"TIFF of compression {kind}": _tiff(8000, 8000, kind, zlib.compress(bytes(64_000_000), 9)) for kind in (5, 8, 32773, 34925)}
    bombs["TIFF with many samples"] = _tiff(4096, 4096, tag277=65535)
    bombs["TIFF with long samples"] = _tiff(4096, 4096, tag258=2**31)
    bombs["TIFF whose directory is its own"] = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", 0) + struct.pack("<I", 8)
    scans = _jpeg(2048, 2048, 3, progressive=True)
    bombs["JPEG of many scans"] = scans[:-2] + scans[scans.index(b"\xff\xda") : -2] * 2000 + b"\xff\xd9"
    bombs["JPEG with long comments"] = b"\xff\xd8" + (b"\xff\xfe\xff\xff" + bytes(65533)) * 300 + _jpeg(16, 16)[2:]
    bombs["empty"], bombs["GIF"], bombs["EPS"] = b"", b"GIF89a" + bytes(100), b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n"
    return bombs


def _luminaire_files(folder: Path) -> list[Path]:
    from tests.support.light_fields import lobed_field
    from vemlight.renderer.luminaire.luminaire_file import write_luminaire

    write_luminaire(folder / "a.exr", lobed_field())
    return [folder / "a.exr"]


def _luminaire_bombs() -> dict[str, bytes]:
    text = b'{"schema":"vemlight.luminaire/1","name":"a","basis":"bell","rows":32,"cols":32,"spacing_m":0.1,"first_m":[0,0],"distance_m":1,'
    text += b'"window_m":[0,0,1,1],"unit":"radiometric"}'
    bombs = dict(_exr_bombs())
    for name, content in (
        ("arrays", b"[" * 100_000),
        ("whole", text),
        ("digits", text.replace(b"0.1", b"9" * 10**6)),
        ("text", b"x" * 10**7),
    ):
        attribute = b"vemlight:luminaire\0string\0" + struct.pack("<i", len(content)) + content
        bombs |= {f"{name} {side}": _exr_header(side, side, attribute) + bytes(4096) for side in (4, 2048, 4096, 16384)}
    return bombs


def _read_luminaire(path: Path) -> object:
    from vemlight.renderer.luminaire.luminaire_file import read_luminaire

    return read_luminaire(path)


def _video_files(folder: Path) -> list[Path]:
    import cv2

    import vemlight.plate.video_source  # noqa: F401, keeps FFmpeg quiet from its first use on

    paths = []
    for name, code in (("a.avi", "MJPG"), ("b.mp4", "mp4v")):
        paths.append(folder / name)
        writer = cv2.VideoWriter(str(paths[-1]), cv2.VideoWriter.fourcc(*code), 24.0, (64, 48))
        for k in range(4):
            writer.write(np.full((48, 64, 3), 20 + 50 * k, np.uint8))
        writer.release()
    return paths


def _video_bombs() -> dict[str, bytes]:
    head = b"\0\0\0\x20ftypisom\0\0\2\0isomiso2avc1mp41"
    avi = b"RIFF\xff\xff\xff\x7fAVI LIST\xff\xff\xff\x7fhdrlavih8\0\0\0"
    bombs = {f"AVI {side}": avi + struct.pack("<14I", 1, 0, 0, 0, 2**31, 0, 1, 0, side, side, 0, 0, 0, 0) for side in (16384, 2**31)}
    bombs |= {
        f"{atom.decode()} of {size}": head + struct.pack(">I", size) + atom + bytes(64)
        for atom in (b"moov", b"mdat", b"free", b"trak")
        for size in (1, 8, 2**31 - 1, 2**32 - 1)
    }
    playlist = b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n%s\n#EXT-X-ENDLIST\n"
    for name in (b"file:///etc/passwd", b"http://127.0.0.1:9/a.ts", b"/dev/zero", b"concat:/etc/passwd|/etc/hosts"):
        bombs[f"playlist of {name.decode()}"] = playlist % name
    bombs["concatenation"] = b"ffconcat version 1.0\nfile /dev/zero\n"
    bombs["SDP"] = b"v=0\no=- 0 0 IN IP4 127.0.0.1\nc=IN IP4 127.0.0.1\nm=video 5004 RTP/AVP 96\na=rtpmap:96 H264/90000\n"
    bombs["Matroska"] = b"\x1a\x45\xdf\xa3\x01" + b"\xff" * 7 + bytes(1000)
    bombs["Matroska of nested masters"] = b"\x1a\x45\xdf\xa3\x80" + b"\x18\x53\x80\x67\x01\xff\xff\xff\xff\xff\xff\xff" * 10_000
    bombs["YUV"] = b"YUV4MPEG2 W100000 H100000 F25:1\nFRAME\n" + bytes(1000)
    bombs["transport stream"] = b"\x47" + b"\xff" * 187 * 100
    bombs["YUV of 16384"] = b"YUV4MPEG2 W16384 H16384 F25:1\nFRAME\n" + bytes(1000)
    bombs["empty"] = b""
    return bombs


def _read_video(path: Path) -> object:
    from vemlight.plate.video_source import open_video_source

    video = open_video_source(path, 25.0)
    return video.picture(0), video.picture(len(video) - 1)


def _with_checksums(content: bytes) -> bytes:
    """A PNG whose chunks have the right checksums."""
    data, at = bytearray(content), 8
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        if at + 12 + length > len(data):
            break
        struct.pack_into(">I", data, at + 8 + length, zlib.crc32(data[at + 4 : at + 8 + length]))
        at += 12 + length
    return bytes(data)


def _read_radiance(path: Path) -> object:
    from vemlight.light.images import read_radiance

    return read_radiance(path)


def _read_codes(path: Path) -> object:
    from vemlight.light.images import read_codes

    return read_codes(path)


FORMATS = {
    "exr": Format(".exr", _exr_files, _read_radiance, _exr_bombs),
    "hdr": Format(".hdr", _hdr_files, _read_radiance, _hdr_bombs),
    "luminaire": Format(".exr", _luminaire_files, _read_luminaire, _luminaire_bombs),
    "png": Format(".png", _png_files, _read_codes, _png_bombs, _with_checksums),
    "photo": Format(".jpg", _photo_files, _read_codes, _photo_bombs),
    "video": Format(".mp4", _video_files, _read_video, _video_bombs),
}
