"""Luminaires, settings, scene, lens and response files, patches and manifests."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.support.hostile.format import Format

IES = b"""IESNA:LM-63-2002
[MANUFAC] me
TILT=NONE
1 1000 1 7 1 1 2 0 0 0
1 1 10
0 15 30 45 60 75 90
0
1000.5 966.4 866.5 707.6 500.5 259.3 0.5
"""
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
    from vemlight.renderer.luminaire.rayfile import TM25_HEADER

    bombs = {}
    for key, value in (
        ("rays", 2**28),
        ("rays", 2**63),
        ("spectra", 2**31 - 1),
        ("spectra", -1),
        ("additional_text", 2**31 - 1),
        ("additional_text", -1),
    ):
        header = np.zeros(1, TM25_HEADER)
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


TOML_BOMBS = {
    "arrays": b"a = " + b"[" * 100_000, "tables": b"a = " + b"{a=" * 100_000, "dots": b"a" + b".a" * 50_000 + b" = 1\n",
    "dotted table": b"[a" + b".a" * 50_000 + b"]\n", "digits": b"a = " + b"9" * 10**6, "text": b'a = "' + b"x" * 10**7,
    "BOM": b"\xef\xbb\xbfa = 1\n",
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
    from vemlight.capture.manifest import read_manifest

    return read_manifest(path.parent)


SCENE = b"""[camera]
from = [3.0, -4.0, 2.5]
at = [0.0, 0.0, 0.5]
[[mesh]]
shape = "sphere"
scale = 0.5
material = {diffuse = [0.6, 0.5, 0.4]}
"""
LENS = b"""size = [160, 160]
f = [48.5, 48.5]
c = [79.5, 79.5]
k1 = -0.012
k2 = 0.0
k3 = 0.0
k4 = 0.0
rim_deg = 93.0
vignetting = [-0.04]
"""
RESPONSE = b'kind = "linear"\nbits = 12\na = 64.0\nb = 1000.0\n'
PATCHES = b"code,luminance,use\n100,1.5,fit\n300,10,fit\n500,80,check\n700,500,fit\n900,3000,fit\n"
LINE = b'{"name":"a.exr","sequence":0,"time_s":0.0,"sha256":"' + b"0" * 64 + b'"}\n'
JSON_BOMBS = {
    "arrays": b"[" * 100_000, "objects": b'{"a":' * 100_000, "lines": LINE * 100_000, "digits": LINE.replace(b"0.0", b"9" * 10**6),
    "path": LINE.replace(b"a.exr", b"../a.exr"), "empty": b"", "NUL": bytes(4096),
}  # fmt: skip
CSV_BOMBS = {
    "quotes": b'"' * 10**6,
    "columns": b"code,luminance,use\n" + b"," * 10**6,
    "rows": PATCHES + b"1,1,fit\n" * 10**6,
    "NUL": bytes(1000),
    "empty": b"",
}


FORMATS = {
    "ies": Format(
        ".ies",
        _text_files(a__ies=IES),
        _read_photometry,
        lambda: {"angles": IES.replace(b" 7 1 1", b" 999999999 999999999 1"), "empty": b""},
    ),
    "ldt": Format(
        ".ldt",
        _text_files(a__ldt=LDT_LINES),
        _read_photometry,
        lambda: {"planes": LDT_LINES.replace(b"\n7\n", b"\n999999999\n"), "empty": b""},
    ),
    "tm25": Format(".tm25ray", _ray_files, _read_rays, _ray_bombs),
    "settings": Format(
        ".toml", _text_files(a__toml=b'mode = "live"\n[capture]\nfps = 20.0\n[sampler]\ncount = 9\n'), _settings, lambda: TOML_BOMBS
    ),
    "scene": Format(".toml", _text_files(a__toml=SCENE), _scene, lambda: TOML_BOMBS),
    "lens": Format(".toml", _text_files(a__toml=LENS), _lens, lambda: TOML_BOMBS),
    "response": Format(".toml", _text_files(a__toml=RESPONSE), _response, lambda: TOML_BOMBS),
    "patches": Format(".csv", _text_files(a__csv=PATCHES), _patches, lambda: CSV_BOMBS),
    "manifest": Format(".jsonl", _text_files(manifest__jsonl=LINE * 3), _manifest, lambda: JSON_BOMBS),
}
