"""Luminaires, settings, scene, lens and response files, patches and manifests."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.support import stage_files
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


def text_files(**contents: bytes) -> Callable[[Path], list[Path]]:
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
    large = (2**31 - 1, -1, -(2**31), 10**6, 1, 9000)
    fields = [(key, value) for key in ("spectra", "additional_text", "additional_items", "version", "start") for value in large]
    for key, value in (*((("rays", count)) for count in (2**28, 2**63, 2**32, 0)), *fields):
        header = np.zeros(1, TM25_HEADER)
        header["magic"], header["version"], header["rays"], header["flags"] = b"TM25", 2013, 1, [1, 1, 0, 0, 1, 0, 0, 0]
        header[key] = value
        bombs[f"{key} {value}"] = header.tobytes() + bytes(40_000)
    return bombs


def _read_photometry(path: Path) -> object:
    from vemlight.light.photometry import read_photometry

    return read_photometry(path)


def _read_rays(path: Path) -> object:
    from vemlight.renderer.luminaire.rayfile import read_rays

    return read_rays(path)


def _stage_files(folder: Path) -> list[Path]:
    path = folder / "a.mvr"
    path.write_bytes(stage_files.mvr(*stage_files.FIXTURES, stage_files.FOCUS))
    return [path]


def _stage_bombs() -> dict[str, bytes]:
    texts = {
        "10 MB": b"<a>" + b" " * 10**7 + b"</a>", "128 MB": b" " * 2**27, "deep": b"<a>" * 10**6, "attributes": b"<a " + b'b="" ' * 10**6
    }  # fmt: skip
    bombs = {name: stage_files.packed({"GeneralSceneDescription.xml": text}) for name, text in texts.items()}
    groups = 5000 * "<GroupObject><ChildList>" + 5000 * "</ChildList></GroupObject>"
    lamp = stage_files.packed({"description.xml": bytes(2**27)})
    return {
        **bombs,
        "no archive": b"PK" * 1000,
        "groups": stage_files.mvr(groups),
        "a large lamp": stage_files.mvr(*stage_files.FIXTURES, stage_files.FOCUS, lamp=lamp),
        "many fixtures": stage_files.mvr(*(20_000 * stage_files.FIXTURES[:1])),
    }


def _read_stage(path: Path) -> object:
    from vemlight.fixtures.rig_file import read_rig

    return read_rig(path)


def _text_bombs(sound: bytes) -> dict[str, bytes]:
    """What may stand in place of any text."""
    return {
        "empty": b"",
        "NUL": bytes(4096),
        "10 MB of NUL": bytes(10**7),
        "10 MB of spaces": b" " * 10**7,
        "10 MB of lines": b"\n" * 10**7,
        "10 MB of quotes": b'"' * 10**7,
        "10 MB of digits": b"9" * 10**7,
        "a long line": sound + b"x" * 10**7,
        "BOM": b"\xef\xbb\xbf" + sound,
        "UTF-16": sound.decode("latin-1").encode("utf-16"),
        "latin-1": sound + b"\xfc",
        "carriage returns": sound.replace(b"\n", b"\r"),
        "itself 10,000 times": sound * 10_000,
        "a cut character": sound + b"\xe2\x82",
        "brackets": b"[" * 10**6,
        "controls": bytes(range(32)) * 1000,
    }


def toml_bombs(sound: bytes) -> dict[str, bytes]:
    bombs = {
        "arrays": b"a = " + b"[" * 100_000,
        "closed arrays": b"a = " + b"[" * 400 + b"]" * 400,
        "tables": b"a = " + b"{a=" * 100_000,
        "dots": b"a" + b".a" * 50_000 + b" = 1\n",
        "dotted table": b"[a" + b".a" * 50_000 + b"]\n",
        "dotted tables": b"[[a" + b".a" * 50_000 + b"]]\n",
        "quoted dots": b'"a"' + b' . "a"' * 50_000 + b" = 1\n",
        "31 dots": b"a" + b".a" * 31 + b" = 1\n",
        "digits": b"a = " + b"9" * 10**6,
        "hexadecimal": b"a = 0x" + b"f" * 10**6,
        "exponent": b"a = 1e999999999\n",
        "text": b'a = "' + b"x" * 10**7,
        "text in lines": b'a = """' + b"x\n" * 500_000,
        "escapes": b'a = "' + b"\\u0000" * 100_000 + b'"\n',
        "NUL in a name": b'file = "a\\u0000b"\n',
        "lines": b"[x]\n" * 300_000,
        "keys": b"".join(b"k%d = 1\n" % k for k in range(80_000)),
        "array of tables": b"[[mesh]]\n" * 100_000,
        "dates": b"a = [" + b"1979-05-27T07:32:00Z," * 40_000 + b"]\n",
        "nan": b"a = nan\n",
        "all sections": sound + b"[a.b.c.d]\n" * 1000,
    }
    return {**_text_bombs(sound), **bombs}


def _scene_bombs() -> dict[str, bytes]:
    from tests.support.hostile.meshes import REFERENCES

    camera = SCENE[: SCENE.index(b"[[mesh]]")]
    names = (*REFERENCES, "pipe", ".", "", "x" * 5000)
    bombs = {f"mesh {name[:40]}": camera + f'[[mesh]]\nfile = "{name}.obj"\n'.encode() for name in names}
    bombs |= {f"luminaire {name[:40]}": SCENE + f'[[luminaire]]\nfile = "{name}"\n'.encode() for name in names}
    bombs |= {f"plate {name[:40]}": SCENE + f'[plate]\nfile = "{name}"\n'.encode() for name in names}
    bombs |= {
        f"{count} {shape}": camera + f'[[mesh]]\nshape = "{shape}"\n'.encode() * count
        for count, shape in ((900, "sphere"), (30_000, "sphere"), (4000, "box"), (30_000, "plane"))
    }
    bombs |= {f"{count} lamps": SCENE + b"[[luminaire]]\n" * count for count in (256, 257, 60_000)}
    bombs["named lamps"] = SCENE + b"".join(b'[[luminaire]]\nname = "%d"\n' % k for k in range(20_000))
    return {**toml_bombs(SCENE), **bombs}


def _settings(path: Path) -> object:
    from vemlight.settings_file import read_settings

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
    from vemlight.capture.calibration.patches import read_patches

    return read_patches(path)


def _manifest(path: Path) -> object:
    from vemlight.capture.manifest import read_manifest

    return read_manifest(path.parent)


LIGHTS = (
    b'{"schema":"vemlight.lights/2","sequence":0,"time_s":0.0,"coverage":"sphere","lights":'
    b'[{"id":0,"direction":[0,0,1],"irradiance":[1,1,1],"covariance":[0.01,0,0,0.01,0,0]},{"id":7,"direction":[1,0,0],"irradiance":[2,1,0]}]}\n'
)
POINTS = (
    b'{"schema":"vemlight.lights/2","sequence":0,"time_s":0.0,"coverage":"sphere","lights":[],"at":[0,0,1],'
    b'"points":[{"id":0,"at":[1,0,2],"intensity":[1,1,1],"radius":0.25,"sigma":0.01},{"id":5,"at":[0,1,2],"intensity":[1,0,1],'
    b'"radius":0.0,"sigma":0.1}]}\n'
)


def _lights(path: Path) -> object:
    """Read as every exchange does: also as directional lights, whose places divide."""
    from vemlight.light.as_directional import as_directional
    from vemlight.light.lights_reader import lights_frames

    return sum(float(as_directional(frame.lights, frame.near).irradiance.sum()) for frame in lights_frames(path))


def _lights_bombs() -> dict[str, bytes]:
    light = b'{"id":%d,"direction":[0,0,1],"irradiance":[1,1,1]}'
    many = b",".join(light % k for k in range(300_000))
    point = b'{"id":%d,"at":[1,0,2],"intensity":[1,1,1],"radius":0.25,"sigma":0.01}'
    numbers = {
        f"{key} of {value.decode()[:20]}": POINTS.replace(b'"%s":0.25' % key.encode(), b'"%s":%s' % (key.encode(), value))
        for key in ("radius",) for value in (b"1e39", b"1e308", b"-1", b"null", b"9" * 400)
    }  # fmt: skip
    numbers |= {f"at {value.decode()}": POINTS.replace(b'"at":[1,0,2]', b'"at":' + value) for value in (b"[0,0,1]", b"[1e39,0,0]", b"[]")}
    return {
        **numbers,
        "points at the rig": POINTS.replace(b'"at":[1,0,2]', b'"at":[0,0,1]').replace(b"[1,1,1]", b"[3e38,3e38,3e38]"),
        "points out of sight": POINTS.replace(b'"at":[1,0,2]', b'"at":[1e6,1e6,1e6]'),
        "points of 3e38": POINTS.replace(b"[1,1,1]", b"[3e38,3e38,3e38]").replace(b'"at":[1,0,2]', b'"at":[0,0,1.0000001]'),
        "257 points": POINTS.replace(b'{"id":5', b",".join(point % k for k in range(10, 265)) + b',{"id":5'),
        "300,000 points": POINTS.replace(b'{"id":5', b",".join(point % k for k in range(10, 300_010)) + b',{"id":5'),
        "arrays": b"[" * 100_000,
        "objects": b'{"a":' * 100_000,
        "a line of 10^7 keys": b"{" + b'"a":1,' * 10**7 + b'"b":1}\n',
        "a line without end": b'{"schema":"' + b"a" * 70_000_000,
        "300,000 lights": LIGHTS.replace(b'{"id":7', many + b',{"id":7'),
        "30,000 frames": b"".join(LIGHTS.replace(b"0.0,", b"%d.5," % k) for k in range(30_000)),
        "exponent": LIGHTS.replace(b"0.0,", b"1e999999,"),
        "digits": LIGHTS.replace(b"0.0,", b"9" * 10**6 + b","),
        "id": LIGHTS.replace(b'"id":7', b'"id":' + b"9" * 4000),
        "unknown keys": LIGHTS.replace(b'{"schema"', b'{"x":' + b"[" * 900 + b"]" * 900 + b',"schema"'),
        "blank lines": b"\n" * 20_000_000,
    }


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
KEYS = b'curve\n    public-key = "3@^1=Cxw-HO1>GJ9VZ.*N=h-pkjz&C/.loJ1qZV8"\n    secret-key = "YMv<4.GGIV*CQ)x&:Sil@&)CZ-a0oFAi9uivXQLw"\n'
NUMBERS = (b"-1", b"0", b"1e308", b"nan", b"inf", b"999999999", b"99999999999999999999", b"2.5", b"x", b"1" * 10**6)


def _photometry_bombs(sound: bytes, places: tuple[bytes, ...]) -> dict[str, bytes]:
    """Other numbers in some of a file's places."""
    bombs = {
        f"{number[:20]!r} for {place!r}": sound.replace(place, place.replace(place.strip(), number), 1)
        for place in places
        for number in NUMBERS
    }
    return {**_text_bombs(sound), **bombs}


def _json_bombs() -> dict[str, bytes]:
    bombs = {
        "arrays": b"[" * 100_000,
        "objects": b'{"a":' * 100_000,
        "lines": LINE * 100_000,
        "700,000 lines": LINE * 700_000,
        "1,500,000 lines": LINE * 1_500_000,
        "digits": LINE.replace(b"0.0", b"9" * 10**6),
        "exponent": LINE.replace(b"0.0", b"1e999999"),
        "sequence": LINE.replace(b":0,", b":%s," % (b"9" * 4000)),
        "a line of 10^7 keys": b"{" + b'"a":1,' * 10**7 + b'"b":1}\n',
        "unknown keys": LINE.replace(b"{", b'{"x":' + b"[" * 900 + b"]" * 900 + b","),
        "long name": LINE.replace(b"a.exr", b"a" * 10**7),
        "surrogates": LINE.replace(b"a.exr", b"\\ud800"),
        "NUL in the name": LINE.replace(b"a.exr", b"a\\u0000"),
        "no line end": LINE[:-1],
    }
    for name in (b"../a.exr", b"/etc/passwd", b"..", b".", b"", b"a/b", b"missing.exr"):
        bombs[f"name {name.decode()}"] = LINE.replace(b"a.exr", name)
    return {**_text_bombs(LINE), **bombs}


def _csv_bombs() -> dict[str, bytes]:
    head = b"code,luminance,use\n"
    return {
        **_text_bombs(PATCHES),
        "quotes": b'"' * 10**5,
        "open quote": PATCHES + b'"' + b"x" * 200_000,
        "columns": head + b"," * 10**6,
        "many columns": b"a," * 100_000 + head,
        "rows": PATCHES + b"1,1,fit\n" * 10**6,
        "30,000 rows": PATCHES + b"1,1,fit\n" * 30_000,
        "blank rows": head + b"\n" * 200_000,
        "nan": PATCHES + b"nan,nan,fit\n",
        "digits": PATCHES + b"9" * 100_000 + b",1,fit\n",
        "exponent": PATCHES + b"1e999,1,fit\n",
        "use": PATCHES + b"1,1," + b"x" * 100_000 + b"\n",
        "no head": b"1,2,fit\n" * 100,
        "a column of dictionaries": head + b"{},[],()\n",
        "tabs": PATCHES.replace(b",", b"\t"),
        "the same column twice": b"code,code,use\n1,1,fit\n",
    }


def _manifest_files(folder: Path) -> list[Path]:
    (folder / "a.exr").touch()
    (folder / "b.jsonl").write_bytes(LINE * 3)
    from vemlight.capture.manifest import ManifestWriter

    (folder / "lens.toml").write_bytes(LENS)
    writer = ManifestWriter(folder, [folder / "lens.toml"])
    for k in range(3):
        writer.add(folder / "a.exr", k, k / 25)
    writer.close((folder / "lens.toml",))
    (folder / "manifest.jsonl").rename(folder / "c.jsonl")
    return [folder / "b.jsonl", folder / "c.jsonl"]


def _with_chains(content: bytes) -> bytes:
    """A manifest each of whose lines follows the one before."""
    from vemlight.journal import KEY, TAIL_BYTES, chained

    lines, chain = [], ""
    for line in content.splitlines():
        if KEY not in line:
            return content
        lines.append(chained(line[: -TAIL_BYTES + 1] + b"}", chain))
        chain = lines[-1][-67:-3].decode()
    return b"".join(lines)


def _keys_bombs() -> dict[str, bytes]:
    bombs = {f"{size} long": KEYS.replace(b'public-key = "', b'public-key = "' + b"a" * size) for size in (0, 3, 5, 100, 10**6)}
    bombs |= {f"all {digit.decode()}": KEYS[:-42] + digit * 40 + KEYS[-2:] for digit in (b"#", b"0", b"-", b"a")}
    return {
        **_text_bombs(KEYS),
        **bombs,
        "no =": KEYS.replace(b"=", b""),
        "many": KEYS * 100_000,
        "equals": b"=" * 10**6,
        "public alone": KEYS[: KEYS.index(b"    secret")],
        "secret alone": KEYS[KEYS.index(b"    secret") :],
    }


def _keys(path: Path) -> object:
    from vemlight.runtime.transport import read_keys

    secret = path.parent / "vemlight.key_secret"
    path.replace(secret)
    secret.chmod(0o600)
    return read_keys(path.parent)


SETTINGS = b'mode = "live"\n[capture]\nfps = 20.0\n[sampler]\ncount = 9\n'
FORMATS = {
    "ies": Format(".ies", text_files(a__ies=IES), _read_photometry, lambda: _photometry_bombs(IES, (b" 7 1 1", b"1000.5", b"\n0 15"))),
    "ldt": Format(
        ".ldt", text_files(a__ldt=LDT_LINES), _read_photometry, lambda: _photometry_bombs(LDT_LINES, (b"\n7\n", b"\n1000\n", b"\n0\n"))
    ),
    "tm25": Format(".tm25ray", _ray_files, _read_rays, _ray_bombs),
    "stage": Format(".mvr", _stage_files, _read_stage, _stage_bombs),
    "settings": Format(".toml", text_files(a__toml=SETTINGS), _settings, lambda: toml_bombs(SETTINGS)),
    "scene": Format(".toml", text_files(a__toml=SCENE), _scene, _scene_bombs),
    "lens": Format(".toml", text_files(a__toml=LENS), _lens, lambda: toml_bombs(LENS)),
    "response": Format(".toml", text_files(a__toml=RESPONSE), _response, lambda: toml_bombs(RESPONSE)),
    "patches": Format(".csv", text_files(a__csv=PATCHES), _patches, _csv_bombs),
    "manifest": Format(".jsonl", _manifest_files, _manifest, _json_bombs, _with_chains),
    "lights": Format(".jsonl", text_files(a__jsonl=LIGHTS, b__jsonl=POINTS), _lights, _lights_bombs),
    "keys": Format(".key", text_files(a__key=KEYS), _keys, _keys_bombs),
}
