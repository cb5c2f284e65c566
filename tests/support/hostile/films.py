"""Films and pictures as sources of light: several containers and codecs, portable float maps, PNG with chunks of colour."""

import gc
from pathlib import Path

import numpy as np

from tests.support.films import Film, write_film
from tests.support.hostile.format import Format
from tests.support.hostile.images import _png_bombs, _video_bombs, _with_checksums, png


def _film_files(folder: Path) -> list[Path]:
    pictures = [np.random.default_rng(k).uniform(0.1, 0.9, (32, 64, 3)) for k in range(4)]
    films = {
        "a.mkv": Film("pq", "bt2020", "bt2020"),
        "b.mp4": Film(pixels="yuv420p", codec="libx264", options={"qp": "10"}),
        "c.mp4": Film("hlg", "bt2020", "bt2020", "limited", "yuv420p10le", "libx265", options={"x265-params": "log-level=none:qp=10"}),
        "d.mov": Film(pixels="yuv422p10le", codec="prores_ks"),
        "e.avi": Film("srgb", matrix="bt601", range="full", pixels="yuvj420p", codec="mjpeg"),
    }
    for name, film in films.items():
        write_film(folder / name, pictures, film, metadata={"stereo_mode": "mono"})
    return [folder / name for name in films]


def _film_bombs() -> dict[str, bytes]:
    tracks = {}
    for width, height in ((16384, 16384), (65535, 65535), (2**31 - 1, 1), (0, 0)):
        size = b"\xb0\x84" + width.to_bytes(4, "big") + b"\xba\x84" + height.to_bytes(4, "big")
        video = b"\xe0" + bytes([0x80 | len(size)]) + size
        entry = b"\xd7\x81\x01\x73\xc5\x81\x01\x83\x81\x01\x86\x86V_FFV1" + video
        track = b"\xae" + bytes([0x80 | len(entry)]) + entry
        tracks[f"Matroska {width}x{height}"] = (
            b"\x1a\x45\xdf\xa3\x8b\x42\x82\x88matroska\x18\x53\x80\x67\x01\xff\xff\xff\xff\xff\xff\xff\x16\x54\xae\x6b"
            + bytes([0x80 | len(track)]) + track + bytes(400)
        )  # fmt: skip
    return _video_bombs() | tracks


def _read_film(path: Path) -> object:
    from vemlight.capture.source import open_files
    from vemlight.settings import Capture

    try:
        source = open_files(Capture(source=str(path), projection="equirect", rows=8, cols=16))
        return source.frame(0), source.frame(len(source) - 1)
    finally:
        source = None
        gc.collect()  # now, for a child cannot end threads that only its parent has


def _pfm_files(folder: Path) -> list[Path]:
    (folder / "a.pfm").write_bytes(b"PF\n16 8\n-1.0\n" + np.ones((8, 16, 3), "<f4").tobytes())
    (folder / "b.pfm").write_bytes(b"Pf\n16 8\n2.5\n" + np.ones((8, 16), ">f4").tobytes())
    return [folder / "a.pfm", folder / "b.pfm"]


def _pfm_bombs() -> dict[str, bytes]:
    sizes = ("99999999 99999999", "16384 8192", "16384 16384", "0 0", "1 999999999", "4096 4096")
    return {f"{size} {kind}": f"{kind}\n{size}\n-1.0\n".encode() + bytes(100) for size in sizes for kind in ("PF", "Pf")} | {
        "scale": b"PF\n4 4\n1e400\n" + bytes(200),
        "no scale": b"PF\n4 4\n........\n" + bytes(200), "empty": b"", "digits": b"PF\n" + b"9" * 10**6,
    }  # fmt: skip


def _picture_files(folder: Path) -> list[Path]:
    from PIL import Image, ImageCms

    pixels = np.random.default_rng(0).integers(0, 256, (16, 32, 3)).astype(np.uint8)
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    Image.fromarray(pixels).save(folder / "a.png", icc_profile=profile)
    (folder / "b.png").write_bytes(png(32, 16))
    return [folder / "a.png", folder / "b.png"]


def _read_picture(path: Path) -> object:
    from vemlight.capture.source import open_files
    from vemlight.settings import Capture

    return open_files(Capture(source=str(path), transfer="srgb", projection="equirect", rows=8, cols=16)).frame(0)


FORMATS = {
    "film": Format(".mkv", _film_files, _read_film, _film_bombs),
    "pfm": Format(".pfm", _pfm_files, _read_film, _pfm_bombs),
    "picture": Format(".png", _picture_files, _read_picture, _png_bombs, _with_checksums),
}
