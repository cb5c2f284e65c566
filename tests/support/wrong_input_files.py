"""The files that wrong inputs to the command line need: settings, scenes, rigs, lights and pictures, most of them wrong themselves."""

import json
import struct
import zlib
from fractions import Fraction
from pathlib import Path

import numpy as np

from vemlight.light.images import write_exr

CAMERA = "[camera]\nfrom = [3.0, -4.0, 2.5]\nat = [0.0, 0.0, 0.6]\n"
LENS = "size = [32, 16]\nf = [5.0, 5.0]\nc = [15.5, 7.5]\nk1 = 0.0\nk2 = 0.0\nk3 = 0.0\nk4 = 0.0\nrim_deg = 90.0\n"
RIG = 'target = [0.0, 0.0, 1.5]\n[[fixture]]\nname = "key"\nat = [2.0, 0.0, 3.0]\ncandela = 9000\nbeam_deg = 30\naddress = 1\n'
CAMERAS = (
    '[[camera]]\nname = "a"\nsource = "good.exr"\nat = [0.0, 0.0, 1.0]\n[[camera]]\nname = "b"\nsource = "good.exr"\nat = [1.0, 0.0, 1.0]\n'
)
PATCHES = "code,luminance,use\n40,1,fit\n60,10,fit\n90,100,fit\n160,1000,fit\n110,300,check\n"
LIGHTS = (
    '{"schema":"vemlight.lights/1","sequence":0,"time_s":0.0,"coverage":"sphere",'
    '"lights":[{"id":0,"direction":[0,0,1],"irradiance":[1,1,1]}]}\n'
)
POINT = (
    '{"schema":"vemlight.lights/2","sequence":0,"time_s":0.0,"coverage":"sphere","lights":[],"at":[0,0,1],'
    '"points":[{"id":0,"at":[1,0,2],"intensity":[1,1,1],"radius":0.25,"sigma":0.01}]}\n'
)
SETTINGS = {
    "colour": "colour = 3\n",
    "cuont": "[sampler]\n\ncuont = 3\n",
    "misplaced": "count = 3\n",
    "section": "[smapler]\ncount = 3\n",
    "none": "[sampler]\ncount = 0\n",
    "text": '[sampler]\ncount = "many"\n',
    "method": '[sampler]\nmethod = "trakced"\n',
    "filter": '[sampler]\nmethod = "standard"\nfilter = "adaptive"\n',
    "odd": "[sampler]\norder = 3\n",
    "nan": "[renderer]\nexposure = nan\n",
    "lamp_alone": '[renderer]\nlamp = [{file = "text.txt", at = [0.0, 0.0, 1.0]}]\n',
    "lamp_file": '[rig]\nfile = "cameras.toml"\n[renderer]\nlamp = [{file = "text.txt", at = [0.0, 0.0, 1.0]}]\n',
    "near_lamp": '[renderer]\nlamp = [{file = "text.txt", at = [0.0, 0.0, nan]}]\n',
    "inf": "[capture]\nfps = inf\n",
    "wide": "[renderer]\nwidth = 8193\n",
    "large": "[renderer]\nwidth = 8192\nheight = 8192\n",
    "tcp": '[wire]\ntransport = "tcp"\n',
    "hosts": '[wire.hosts]\nsampeler = "127.0.0.1"\n',
    "lossless": 'mode = "lossless"\n[capture]\nsource = "/dev/video0"\n',
    "token": '[viewer]\ntoken = "short"\n',
    "both": '[viewer]\ntoken = "0123456789abcdef"\ninsecure = true\n',
    "port": "[viewer]\nport = 70000\n",
    "unmasked": "[capture]\nrows = 90\n",
    "line": "\n\n[[capture.masks]]\npoints = [[0.0, 0.0], [1.0, 1.0]]\n",
    "unclosed": 'mode = "live"\n[viewer\n',
    "twice": "[sampler]\ncount = 3\ncount = 4\n",
    "open": "[wire]\ninsecure = true\n",
    "deferred": 'mode = "lossless"\n',
    "origins": '[viewer]\norigins = ["stage.example"]\n',
    "source": '[capture]\nsource = "nowhere"\n',
    "square": '[capture]\nsource = "square.exr"\n',
    "no_lens": '[capture]\nsource = "good.exr"\nlens = "nowhere.toml"\n',
    "format": '[capture]\nsource = "codes.png"\nlens = "camera.toml"\nresponse = "sensor.toml"\nformat = "RG99"\n',
    "start": '[capture]\nsource = "sequence"\nstart = 3\n',
    "record": '[capture]\nsource = "sequence"\nrecord = "rec"\n',
    "scene": '[renderer]\nscene = "nowhere.toml"\n',
    "mesh": '[renderer]\nscene = "ghost.scene.toml"\n',
    "video": '[renderer]\nvideo = "film.avi"\n',
    "no_out": '[renderer]\nvideo = "film.mp4"\n',
    "plate": '[plate]\nsource = "nowhere"\n',
    "no_rig": '[fixtures]\nrig = "nowhere.toml"\n',
    "wrong_rig": '[fixtures]\nrig = "near.rig.toml"\n',
    "unarmed": "[fixtures]\narm = true\n",
    "lamps": 'mode = "lossless"\n[fixtures]\nrig = "good.rig.toml"\n',
    "film": '[plate]\nsource = "broken.mp4"\n',
    "one_camera": '[rig]\nfile = "one.cameras.toml"\n',
    "no_cameras": '[rig]\nfile = "nowhere.toml"\n',
    "same_name": '[rig]\nfile = "named.cameras.toml"\n',
    "too_near": '[rig]\nfile = "near.cameras.toml"\n',
    "turned": '[rig]\nfile = "turn.cameras.toml"\n',
    "rates": '[rig]\nfile = "rate.cameras.toml"\n',
    "no_source": '[rig]\nfile = "source.cameras.toml"\n',
    "live_camera": 'mode = "lossless"\n[rig]\nfile = "live.cameras.toml"\n',
    "two_sources": '[capture]\nsource = "good.exr"\n[rig]\nfile = "cameras.toml"\n',
    "no_port": '[wire]\ntransport = "tcp"\ninsecure = true\n[rig]\nfile = "cameras.toml"\n',
    "name": '[wire.names]\nrenderer = "viewer.b"\n',
    "elsewhere": 'mode = "lossless"\n[wire]\nelsewhere = ["sampler"]\n',
    "keys": '[wire]\ntransport = "tcp"\nkeys = "nowhere"\n',
}
SCENES = {
    "empty": CAMERA,
    "ghost": CAMERA + '[[mesh]]\nfile = "ghost.obj"\n',
    "shape": CAMERA + '[[mesh]]\nshape = "cube"\n',
    "material": CAMERA + '[[mesh]]\nshape = "box"\nmaterial = {diffuse = [1.0, 1.0, 1.0], rougness = 0.3}\n',
    "bright": CAMERA + '[[mesh]]\nshape = "box"\nmaterial = {diffuse = [0.8, 0.8, 0.8], specular = [0.4, 0.4, 0.4]}\n',
    "two": CAMERA + '[[mesh]]\nshape = "box"\nmaterial = {diffuse = [0.8, 0.8, 0.8], metallic = 0.4}\n',
    "view": "[camera]\nfrom = [0.0, 0.0, 0.6]\nat = [0.0, 0.0, 0.6]\n[[mesh]]\nshape = 'box'\n",
    "inf": "[camera]\nfrom = [0.0, inf, 0.6]\nat = [0.0, 0.0, 0.6]\n[[mesh]]\nshape = 'box'\n",
    "camera": '[[mesh]]\nshape = "box"\n',
    "broken": CAMERA + '[[mesh]]\nfile = "broken.obj"\n',
    "outside": CAMERA + '[[mesh]]\nfile = "../good.obj"\n',
}
FILES = {
    **{f"{name}.toml": text for name, text in SETTINGS.items()},
    **{f"{name}.scene.toml": text for name, text in SCENES.items()},
    "lights.jsonl": LIGHTS,
    "rows.jsonl": LIGHTS + LIGHTS,
    "dark.jsonl": "\n",
    "point_inf.jsonl": POINT.replace("0.25", "1e39"),
    "point_far.jsonl": POINT.replace('"at":[1,0,2]', '"at":[2e6,0,2]'),
    "point_strong.jsonl": POINT.replace('"intensity":[1,1,1]', '"intensity":[1e31,1,1]'),
    "point_pair.jsonl": POINT.replace('"lights":[],"at":[0,0,1],', '"lights":[],'),
    "schema.jsonl": LIGHTS.replace("lights/1", "lights/9"),
    "camera.toml": LENS,
    "no_f.lens.toml": LENS.replace("f = [5.0, 5.0]\n", ""),
    "rim.lens.toml": LENS.replace("90.0", "400.0"),
    "other.lens.toml": LENS.replace("[32, 16]", "[64, 48]"),
    "sensor.toml": 'kind = "linear"\nbits = 8\na = 0.0\nb = 0.01\n',
    "gamma.response.toml": 'kind = "gamma"\nbits = 8\n',
    "keyframes.toml": "[[key]]\ntime_s = 1.0\nrotate_deg = [0.0, 0.0, 0.0]\n[[key]]\ntime_s = 0.0\nrotate_deg = [0.0, 0.0, 9.0]\n",
    "recipe.toml": "name = 'lamp'\n",
    "falling.csv": "code,luminance,use\n160,1,fit\n90,10,fit\n60,100,fit\n40,1000,fit\n110,5,check\n",
    "column.csv": PATCHES.replace("luminance", "brightness"),
    "use.csv": PATCHES.replace("check", "chek"),
    "number.csv": PATCHES.replace("60,10,", "60,ten,"),
    "nan.csv": PATCHES.replace("60,10,", "60,nan,"),
    "few.csv": PATCHES.replace("60,10,fit\n90,100,fit\n", ""),
    "broken.obj": "v 1 2\nf 1 2 3\n",
    "taken": "a file where a folder is wanted\n",
    "broken.mp4": "no film\n",
    "rays.tm25ray": "no rays\n",
    "good.rig.toml": RIG,
    "near.rig.toml": RIG.replace("[2.0, 0.0, 3.0]", "[0.0, 0.0, 1.5]"),
    "cadela.rig.toml": RIG.replace("candela", "cadela"),
    "host.rig.toml": RIG + '[output]\ndestination = "no.such.host.invalid"\n',
    "cameras.toml": CAMERAS,
    "one.cameras.toml": CAMERAS[: CAMERAS.rindex("[[camera]]")],
    "named.cameras.toml": CAMERAS.replace('"b"', '"a"'),
    "near.cameras.toml": CAMERAS.replace("[1.0, 0.0", "[0.005, 0.0"),
    "turn.cameras.toml": CAMERAS + "turn = [1.0, 0.0, 0.0, 1.0]\n",
    "source.cameras.toml": CAMERAS.replace('"b"\nsource = "good.exr"', '"b"\nsource = "nowhere"'),
    "live.cameras.toml": CAMERAS.replace('"b"\nsource = "good.exr"', '"b"\nsource = "/dev/video0"'),
    "size.cameras.toml": CAMERAS.replace('"b"\nsource = "good', '"b"\nsource = "square').replace('exr"\n', 'exr"\nlens = "camera.toml"\n'),
    "rate.cameras.toml": CAMERAS.replace('"a"\nsource = "good.exr"', '"a"\nsource = "sequence"').replace("good.exr", "fast"),
    "table.rig.toml": RIG.replace("beam_deg = 30", 'photometry = "lamp.ies"'),
    "lamp.ies": "no lamp\n",
    "stage.mvr": "no stage\n",
    "text.txt": "no picture\n",
}


def write_wrong_inputs(folder: Path) -> None:
    """Writes the files that the commands of tests/support/wrong_inputs.py name."""
    for name, text in FILES.items():
        (folder / name).write_text(text)
    image = np.full((16, 32, 3), 0.5, np.float32)
    write_exr(folder / "good.exr", image)
    write_exr(folder / "square.exr", image[:, :16])
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n"
    (folder / "good.hdr").write_bytes(header + bytes([128, 128, 128, 128]) * 32)
    (folder / "cut.hdr").write_bytes(header + bytes([128, 128, 128, 128]) * 16)
    (folder / "noise.hdr").write_bytes(np.random.default_rng(1).bytes(300).replace(b"\n", b" "))
    for name in ("photo.png", "codes.png", "png.hdr", "png.exr"):
        (folder / name).write_bytes(gray_png(32, 16))
    exr = (folder / "good.exr").read_bytes()
    (folder / "exr.hdr").write_bytes(exr)
    (folder / "cut.exr").write_bytes(exr[: len(exr) // 2])
    for name in ("empty.hdr", "empty.exr"):
        (folder / name).touch()
    (folder / "utf16.toml").write_bytes("[sampler]\n".encode("utf-16"))
    for name in ("sequence", "fast", "nothing", "sequence.json", "damaged", "missing", "changed"):
        (folder / name).mkdir()
    for k in range(3):
        write_exr(folder / "sequence" / f"f_{k:04d}.exr", image)
        write_exr(folder / "fast" / f"f_{k:04d}.exr", image, {"framesPerSecond": Fraction(50)})
    (folder / "damaged" / "manifest.jsonl").write_text("{]\n{}\n")
    for name, frame in (("missing", "f_0009.exr"), ("changed", "f_0000.exr")):
        write_exr(folder / name / "f_0000.exr", image)
        row = {"name": frame, "sequence": 0, "time_s": 0.0, "sha256": 64 * "0"}
        (folder / name / "manifest.jsonl").write_text(json.dumps(row) + "\n")


def gray_png(width: int, height: int) -> bytes:
    """A PNG picture of one gray, 8 bits."""
    rows = zlib.compress((b"\x00" + bytes([100]) * width) * height)
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)), (b"IDAT", rows), (b"IEND", b""))
    parts = [struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
