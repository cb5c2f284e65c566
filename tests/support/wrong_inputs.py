"""Wrong inputs to the command line: the files that they need, and for each command what its one line has to name."""

import json
import struct
import zlib
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

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


class Wrong(NamedTuple):
    """A command, of words without spaces in them, and what its line names; `out` in a command is a name that is free."""

    command: str
    words: tuple[str, ...]


def _rows(*rows: tuple[str, str]) -> list[Wrong]:
    return [Wrong(command, tuple(words.split(" | "))) for command, words in rows]


WRONG = [
    # words that click refuses
    *_rows(
        ("lights", "SOURCE: is missing | vemlight lights --help"),
        ("lights good.exr", "--out: is missing | LIGHTS.json"),
        ("lights good.exr extra --out out.json", "extra argument (extra)"),
        ("lights good.exr --coutn 3 --out out.json", "--coutn | did you mean --count"),
        ("lights good.exr --out", "--out: has no value"),
        ("archive nowhere --out out", "nowhere | check the path"),
        ("archive good.exr --out good.exr", "--out: good.exr | is a file"),
        ("archive good.exr --out out --chunk 0", "--chunk: 0"),
        ("archive good.exr --out out --workers 0", "--workers: 0"),
        ("archive good.exr --out out --workers 2 --scheduler tcp://127.0.0.1:1", "--scheduler | leave --workers out"),
        ("archive good.exr --out out --maps-only --from-maps", "--from-maps | run one after the other"),
        ("archive good.exr --out out --from-maps --workers 2", "--workers | leave one of them out"),
        ("archive good.exr --out out --index 1", "--index | add --maps-only"),
        ("archive good.exr --out out --maps-only --index 2 --indices 2", "--index 2 | count from 0"),
        ("archive cut.exr --out out", "cut.exr"),
        ("archive rtsp://127.0.0.1/live --out out --frames 3", "rtsp://127.0.0.1/live | record it first"),
        ("lights good.exr --count 0 --out out.json", "--count: 0 | 1<=x<=100000"),
        ("lights good.exr --count 2.5 --out out.json", "--count: '2.5' is no whole number"),
        ("lights good.exr --count many --out out.json", "--count: 'many' is no whole number"),
        ("lights good.exr --method trakced --out out.json", "--method: trakced | havran-azimuth | did you mean tracked?"),
        ("lights good.exr --filter fir2004 --out out.json", "--filter: fir2004 | did you mean fir2005?"),
        ("lights good.exr --coverage dome --out out.json", "--coverage: dome | choose from hemisphere, sphere"),
        ("ligths good.exr", "'ligths' | did you mean lights?"),
        ("calibrate lnes", "'lnes' | did you mean lens?"),
        ("health", "SERVICE: is missing | choose from capture"),
        ("health captrue", "SERVICE: captrue | did you mean capture?"),
        ("run --mode fast", "--mode: fast | choose from live, lossless"),
        ("--frobnicate", "'--frobnicate' | vemlight --help"),
        ("lights good.exr --json --quiet --out out.json", "--json | --quiet"),
        ("lights good.exr --json --out -", "--json | --out -"),
    ),
    # numbers that are none
    *_rows(
        ("lights good.exr --fps nan --out out.json", "--fps: nan and inf"),
        ("lights good.exr --error nan --out out.json", "--error: nan and inf"),
        ("lights good.exr --error 0 --out out.json", "--error: 0.0 is not in the range"),
        ("render good.exr --exposure nan --out out.png", "--exposure: nan and inf"),
        ("render good.exr --exposure inf --out out.png", "--exposure: inf is not in the range"),
        ("simulate sky --lens camera.toml --rotate nan --out out", "--rotate: nan and inf"),
        ("simulate sky --lens camera.toml --noise nan --out out", "--noise: nan and inf"),
        ("simulate sky --lens camera.toml --noise inf --out out", "--noise: nan and inf"),
        ("simulate sky --lens camera.toml --flicker nan --out out", "--flicker: nan and inf"),
        ("luminaire from-rays rays.tm25ray --plane-z nan --out out.exr", "--plane-z: nan and inf"),
        ("luminaire from-rays rays.tm25ray --spacing inf --out out.exr", "--spacing: nan and inf"),
        ("calibrate response falling.csv --white nan --out out.toml", "--white: nan and inf"),
        ("calibrate response codes.png --white 9 --corners nan,2,3,4,5,6,7,8 --out out.toml", "--corners nan,2,3 | eight numbers"),
        ("calibrate response codes.png --white 9 --corners 1,2,3 --out out.toml", "--corners 1,2,3 | eight numbers"),
        ("calibrate lens photo.png --board 8x6 --square 0 --out out.toml", "--square: 0.0 is not in the range"),
        ("render good.exr --size 640 --out out.png", "--size 640 | 640x480"),
        ("render good.exr --size 9000x2 --out out.png", "--size 9000x2 | 8192"),
    ),
    # where to write to
    *_rows(
        ("lights good.exr --out out.txt", "--out: out.txt | .json or .jsonl"),
        ("lights sequence --out out.json", "out.json | .jsonl"),
        ("lights good.exr --out nowhere/out.json", "--out: nowhere/out.json | no folder nowhere"),
        ("lights good.exr --out sequence.json", "--out: sequence.json is a folder"),
        ("render good.exr --exr quarter --out out.exr", "--exr: quarter is no choice | half, float"),
        ("render good.exr --out out.gif", "--out: out.gif | .exr or .png"),
        ("render good.exr", "--out, --video"),
        ("render good.exr --video out.avi", "--video: out.avi | .mp4"),
        ("polar good.exr --lens camera.toml --out out.png", "--out: out.png | .exr"),
        ("record --source sequence --out taken", "--out: taken | is a file"),
        ("record --source sequence --out taken/out", "--out: taken/out | taken is a file"),
        ("simulate sky --lens camera.toml --out taken", "--out: taken | is a file"),
        ("chart good.exr --out taken", "--out: taken | is a file"),
        ("run --out taken", "--out: taken | is a file"),
        ("keys taken", "FOLDER: taken | is a file"),
        ("luminaire show lamp.exr --out taken", "--out: taken | is a file"),
    ),
    # exports
    *_rows(
        ("export good.exr", "--usd, --gltf, --mcap: none is given"),
        ("export good.exr --usd out.usd", "--usd: out.usd | .usda or .usdc"),
        ("export good.exr --gltf out.obj", "--gltf: out.obj | .gltf or .glb"),
        ("export good.exr --mcap out.bag", "--mcap: out.bag | .mcap"),
        ("export nowhere.jsonl --usd out.usda", "nowhere.jsonl: there is no such file"),
        ("export dark.jsonl --usd out.usda", "dark.jsonl: holds no frame"),
        ("export rows.jsonl --usd out.usda --gltf out.gltf", "rows.jsonl: line 2: | time_s"),
        ("export schema.jsonl --gltf out.gltf", "schema.jsonl: line 1: schema vemlight.lights/9"),
        ("export lights.jsonl --count 3 --gltf out.gltf", "--count: lights.jsonl has its lights already"),
        ("export lights.jsonl --points --gltf out.gltf", "lights.jsonl has its lights already"),
        ("render lights.jsonl --count 3 --out out.png", "--count: lights.jsonl has its lights already"),
        ("render lights.jsonl --background map --out out.png", "--background map: lights.jsonl holds lights and no map"),
        ("render dark.jsonl --out out.png", "dark.jsonl: holds no frame"),
        ("render point_inf.jsonl --out out.png", "point_inf.jsonl: line 1: near lights have a number that is not finite"),
        ("render point_far.jsonl --out out.png", "point_far.jsonl: line 1: near lights have a place, radius or sigma beyond 1e+06 m"),
        ("render point_strong.jsonl --out out.png", "point_strong.jsonl: line 1: near lights have an intensity above 1e+30 W/sr"),
        ("render point_pair.jsonl --out out.png", "point_pair.jsonl: line 1: has one of the keys at and points"),
        ("export lights.jsonl --frame 1 --gltf out.gltf", "--frame 1: | 1 frame"),
        ("export lights.jsonl --residual --usd out.usda", "--residual: | the source"),
        ("export good.exr --residual --gltf out.gltf", "--residual: | --usd"),
        ("relay", "SERVICE: is missing"),
        ("relay renderer --listen 127.0.0.1:5702", "SERVICE: renderer is no choice"),
        ("relay sampler", "--listen: is missing"),
        ("relay sampler --listen 5702", "--listen 5702: is not HOST:PORT"),
        ("relay sampler --listen 127.0.0.1:5702", "[wire] has no keys | vemlight keys"),
        ("relay sampler open.toml --listen 127.0.0.1:2", "--listen 127.0.0.1:2: is too low a port"),
        ("relay sampler open.toml --listen 127.0.0.1:5702 --bytes 800", "--bytes 800: has no room for a light"),
        ("relay sampler deferred.toml --listen 127.0.0.1:5702", "lossless | live mode"),
        ("stream", "--osc, --jsonl: none is given"),
        ("stream --osc 9000", "--osc 9000: is not HOST:PORT"),
        ("stream --osc 127.0.0.1:99999", "--osc 127.0.0.1:99999: is not HOST:PORT"),
        ("stream --jsonl ::1:9000", "--jsonl ::1:9000: is not HOST:PORT"),
        ("stream --osc nowhere.invalid:9000", "--osc nowhere.invalid:9000: has no address"),
        ("stream nowhere.toml --osc 127.0.0.1:9000", "nowhere.toml: there is no such file"),
        ("stream deferred.toml --osc 127.0.0.1:9000", "lossless | live mode"),
        ("export good.exr --usd-dialect maya --usd out.usda", "--usd-dialect: maya is no choice"),
    ),
    # several cameras
    *_rows(
        ("locate", "RIG: is missing"),
        ("locate cameras.toml", "--out: is missing"),
        ("locate nowhere.toml --out out.jsonl", "nowhere.toml: there is no such file"),
        ("locate cameras.toml --subject 1,2 --out out.jsonl", "--subject: 1,2 is not 3 numbers"),
        ("locate cameras.toml --coverage dome --out out.jsonl", "--coverage: dome | hemisphere, sphere"),
        ("locate cameras.toml --out out.txt", "--out: out.txt | .json or .jsonl"),
        ("locate good.rig.toml --out out.jsonl", "good.rig.toml: | there is no such key"),
        ("locate one.cameras.toml --out out.jsonl", "one.cameras.toml: the rig has 1 cameras | [[camera]]"),
        ("locate named.cameras.toml --out out.jsonl", "named.cameras.toml: two cameras are called a"),
        ("locate near.cameras.toml --out out.jsonl", "near.cameras.toml: cameras a and b stand 0.5 cm from each other"),
        ("locate turn.cameras.toml --out out.jsonl", "turn.cameras.toml: | camera b: turn | no unit quaternion"),
        ("locate source.cameras.toml --out out.jsonl", "source.cameras.toml: camera b: | nowhere: there is no such file"),
        ("locate live.cameras.toml --out out.jsonl", "live.cameras.toml: camera b: /dev/video0: is live | vemlight record"),
        ("locate size.cameras.toml --out out.jsonl", "size.cameras.toml: camera b: | square.exr: is 16x16 | 32x16"),
        ("locate rate.cameras.toml --out out.jsonl", "rate.cameras.toml: camera b: has | frames a second"),
    ),
    # pictures and recordings
    *_rows(
        ("lights nowhere.hdr --out out.json", "nowhere.hdr: there is no such file | check the path"),
        ("lights /dev/null --frames 1 --out out.json", "/dev/null: is no camera"),
        ("lights broken.mp4 --out out.jsonl", "broken.mp4: "),
        ("lights good.exr --transfer pq --out out.json", "good.exr: holds radiance | --transfer"),
        ("lights good.exr --projection cube3x2 --out out.json", "good.exr: is 32x16 | cube3x2"),
        ("lights good.exr --projection cube --out out.json", "--projection: cube is no choice | cube3x2"),
        ("lights good.exr --span 400,90 --out out.json", "--span | 360"),
        ("lights good.exr --ground 1.5 --out out.json", "--ground: 1.5"),
        ("lights good.exr --masks none.toml --out out.json", "none.toml"),
        ("lights good.exr --masks tcp.toml --out out.json", "tcp.toml"),
        ("lights good.exr --masks nowhere.toml --out out.json", "nowhere.toml"),
        ("lights good.exr --masks port.toml --out out.json", "port.toml | 65000"),
        ("lights good.exr --masks unmasked.toml --out out.json", "unmasked.toml | has no [[capture.masks]] | draw some on the page"),
        ("lights good.exr --masks line.toml --out out.json", "line.toml: line 3 | 3 points or more"),
        ("lights good.exr --ground 0.2 --coverage sphere --out out.json", "coverage sphere has its own | leave one of them out"),
        ("lights good.exr --lens camera.toml --projection equirect --out out.json", "lens is for fisheye frames"),
        ("lights good.exr --lens camera.toml --lens other.lens.toml --out out.json", "other.lens.toml: is for 64x48 | 32x16"),
        ("lights codes.png --transfer pk --out out.json", "--transfer | pk is no choice | pq"),
        ("lights http://user:word@127.0.0.1:9/x --out out.jsonl", "http://127.0.0.1:9/x: has no last frame | --frames"),
        ("lights http://user:word@127.0.0.1:9/x --frames 2 --out out.jsonl", "http://127.0.0.1:9/x: cannot be played (Connection refused)"),
        ("lights good.exr --control gain --out out.json", "--control: gain is not NAME=VALUE"),
        ("lights /dev/video9 --out out.json", "/dev/video9: has no last frame | --frames N"),
        ("lights codes.png --brackets --out out.json", "codes.png: is one file | --brackets"),
        ("lights sequence --brackets --out out.json", "f_0000.exr: does not say its exposure time | EXIF"),
        ("lights nothing --brackets --out out.json", "nothing: holds none of .exr"),
        ("lights /dev/video9 --brackets --frames 2 --out out.json", "brackets is for folders of photographs"),
        ("lights good.exr --exposures 1,0.1 --out out.json", "exposures is for cameras"),
        ("lights /dev/video9 --exposures 1,x --frames 2 --out out.json", "--exposures: 1,x is not a list of numbers"),
        ("simulate sky --lens camera.toml --exposures 1,0.1 --out out", "--exposures: are of raw codes | --response"),
        ("simulate sky --lens camera.toml --response sensor.toml --exposures 1,1 --out out", "--exposures: exposures 1, 1 are not two"),
        ("simulate sky --lens camera.toml --exposures nan,1 --out out", "--exposures: nan,1 is not a list of numbers"),
        ("lights text.txt --out out.json", "text.txt | .hdr and .pfm, not .txt"),
        ("lights camera.toml --out out.json", "camera.toml | .hdr and .pfm, not .toml"),
        ("lights png.hdr --out out.json", "png.hdr: is a PNG picture and is named .hdr"),
        ("lights png.exr --out out.json", "png.exr: is a PNG picture and is named .exr"),
        ("lights exr.hdr --out out.json", "exr.hdr: is an OpenEXR picture and is named .hdr"),
        ("lights noise.hdr --out out.json", "noise.hdr: is no Radiance picture"),
        ("lights empty.hdr --out out.json", "empty.hdr: is empty"),
        ("lights empty.exr --out out.json", "empty.exr"),
        ("lights cut.exr --out out.json", "cut.exr"),
        ("lights cut.hdr --out out.json", "cut.hdr: is cut off"),
        ("lights square.exr --out out.json", "square.exr: is 16x16 | lens.toml"),
        ("lights good.exr --layer diffuse --out out.json", "good.exr: has no layer diffuse"),
        ("lights good.exr --lens other.lens.toml --out out.json", "good.exr: is 32x16 | 64x48"),
        ("lights good.exr --lens nowhere.toml --out out.json", "nowhere.toml: there is no such file"),
        ("lights good.exr --lens camera.toml --response gamma.response.toml --out out.json", 'line 1: kind = "gamma" | log'),
        ("lights codes.png --out out.json", "codes.png: does not say how its codes become light | --transfer | --response"),
        ("lights codes.png --lens camera.toml --out out.json", "codes.png: does not say how its codes become light | --response"),
        ("lights nothing --out out.jsonl", "nothing: holds none of .exr"),
        ("lights damaged --out out.jsonl", "manifest.jsonl: line 1"),
        ("lights missing --out out.jsonl", "f_0009.exr | missing"),
        ("lights changed --out out.json", "f_0000.exr | not what was recorded"),
        ("chart nowhere.hdr --out out", "nowhere.hdr: there is no such file"),
        ("record --source nowhere --out out", "nowhere: there is no such file"),
        ("record --source /dev/video99 --out out", "/dev/video99 | check the path"),
        ("polar square.exr --lens camera.toml --out out.exr", "square.exr: is 16x16 | 32x16"),
        ("polar good.exr --lens no_f.lens.toml --out out.exr", "no_f.lens.toml | no f; add"),
        ("polar good.exr --lens rim.lens.toml --out out.exr", "rim.lens.toml | rim_deg"),
        ("polar good.exr --lens png.hdr --out out.exr", "png.hdr: is a PNG picture, and not TOML"),
        ("simulate nowhere.hdr --lens camera.toml --out out", "nowhere.hdr | sky, interior"),
        ("simulate png.hdr --lens camera.toml --out out", "png.hdr: is a PNG picture"),
        ("simulate sky --lens camera.toml --keyframes keyframes.toml --out out", "keyframes.toml: time_s must rise"),
        ("simulate sky --lens camera.toml --mosaic rggb --out out", "--mosaic: rggb | did you mean RGGB?"),
    ),
    # calibration and lamps
    *_rows(
        ("calibrate lens nowhere.jpg --board 8x6 --square 0.03 --out out.toml", "nowhere.jpg: there is no such file"),
        ("calibrate lens photo.png --board 8x6 --square 0.03 --out out.toml", "photo.png: no board of 8x6 | --board"),
        ("calibrate lens photo.png --board 1x1 --square 0.03 --out out.toml", "--board 1x1"),
        ("calibrate lens photo.png --board 8 --square 0.03 --out out.toml", "--board 8 | 8x6"),
        ("calibrate lens photo.png --board 8x6 --square 0.03 --dictionary Board --out out.toml", "--dictionary Board | DICT_4X4_50"),
        ("calibrate lens photo.png --board 8x6 --square 0.03 --dictionary DICT_4X4_50 --out out.toml", "--marker 0 | --square"),
        ("calibrate lens text.txt --board 8x6 --square 0.03 --out out.toml", "text.txt: is not a readable image"),
        ("calibrate lens good.exr --board 8x6 --square 0.03 --out out.toml", "good.exr: is not a readable image but an OpenEXR picture"),
        ("calibrate response nowhere.csv --out out.toml", "nowhere.csv: there is no such file"),
        ("calibrate response falling.csv --bits 8 --out out.toml", "falling.csv: | rise"),
        ("calibrate response column.csv --out out.toml", "column.csv: has no column 'luminance'"),
        ("calibrate response use.csv --out out.toml", "use.csv: line 6: use = 'chek' | check"),
        ("calibrate response number.csv --out out.toml", "number.csv: line 3 | 'ten'"),
        ("calibrate response nan.csv --out out.toml", "nan.csv: line 3 | finite"),
        ("calibrate response few.csv --bits 8 --out out.toml", "few.csv: | needs 4"),
        ("calibrate webcam /dev/video99 --out out.toml", "/dev/video99"),
        ("calibrate webcam /dev/null --out out.toml", "/dev/null: is no camera"),
        ("calibrate response photo.png --brackets --out out.toml", "photo.png: is no folder"),
        ("calibrate response sequence --brackets --white 9 --out out.toml", "--white: is for patches"),
        ("calibrate response sequence --brackets --out out.toml", "f_0000.exr: does not say its exposure time"),
        ("calibrate response photo.png --out out.toml", "photo.png: is a PNG picture"),
        ("calibrate response photo.png --white 9 --out out.toml", "no ColorChecker | corners"),
        ("calibrate response photo.png --corners 1,2,3,4,5,6,7,8 --out out.toml", "--corners | --white"),
        ("luminaire show nowhere.exr", "nowhere.exr: there is no such file"),
        ("luminaire show good.exr", "good.exr | vemlight luminaire"),
        ("luminaire show camera.toml", "camera.toml | .ies"),
        ("luminaire show lamp.ies", "lamp.ies"),
        ("luminaire measure recipe.toml --out out.exr", "recipe.toml | planes"),
        ("luminaire from-rays rays.tm25ray --out out.exr", "rays.tm25ray | TM-25"),
    ),
    # real fixtures
    *_rows(
        ("dmx nowhere.toml", "nowhere.toml: there is no such file"),
        ("dmx png.hdr", "png.hdr: is a PNG picture, and not TOML"),
        ("dmx near.rig.toml --lights text.json", "near.rig.toml: fixture key | within 0.1 m"),
        ("dmx cadela.rig.toml", "cadela.rig.toml | cadela | did you mean candela?"),
        ("dmx host.rig.toml", "no.such.host.invalid | no host"),
        ("dmx table.rig.toml", "lamp.ies: is no valid photometry"),
        ("dmx good.rig.toml --lights nowhere.jsonl", "nowhere.jsonl: there is no such file"),
        ("dmx good.rig.toml --lights text.txt --out out.jsonl", "text.txt: line 1"),
        ("dmx good.rig.toml --out out.jsonl", "--out | --lights"),
        ("dmx good.rig.toml --lights text.txt --out out.json", "--out: out.json | .jsonl"),
        ("dmx good.rig.toml --lights text.txt --out out.jsonl --arm", "--out | --arm"),
        ("dmx good.rig.toml none.toml --lights text.txt", "--lights | none.toml"),
        ("dmx stage.mvr", "stage.mvr: is no zip archive"),
        ("calibrate rig good.rig.toml start.toml", "--arm | one at a time"),
        ("calibrate rig good.rig.toml --arm", "SETTINGS: is missing"),
        ("calibrate rig good.rig.toml start.toml --wand a,b:1", "--wand: is for rigs of cameras | holds fixtures"),
        ("calibrate rig cameras.toml --arm", "--arm: is for rigs of fixtures | holds cameras"),
        ("calibrate rig cameras.toml", "--wand: is missing | A,B:METRES"),
        ("calibrate rig cameras.toml --wand a,b", "--wand a,b | left,right:1.25"),
        ("calibrate rig cameras.toml --wand a,c:1", "has no camera c | a, b"),
        ("calibrate rig cameras.toml --wand a,b:1", "at 0 places, and 12 are needed"),
        ("calibrate rig good.rig.toml start.toml --arm", "start.toml | no camera or stream"),
        ("calibrate rig good.rig.toml start.toml --arm --level 0", "--level: 0.0 is not in the range"),
        ("calibrate rig near.rig.toml start.toml --arm", "near.rig.toml: fixture key | within 0.1 m"),
        ("run --rig nowhere.toml", "nowhere.toml: there is no such file"),
        ("run --rig good.rig.toml --out out", "[fixtures] rig | lossless"),
    ),
    # scenes
    *_rows(
        *((f"render good.exr --scene {name}.scene.toml --out out.png", f"{name}.scene.toml | {words}") for name, words in (
            ("empty", "no mesh; add"),
            ("ghost", "ghost.obj"),
            ("shape", 'line 5: [mesh 1] shape = "cube" | box'),
            ("material", "line 6: [mesh 1.material] rougness | did you mean roughness?"),
            ("bright", "[[mesh]] 1 | 1.2 of the light"),
            ("two", "[[mesh]] 1 | either"),
            ("view", "[camera] from and at"),
            ("inf", "line 2: [camera] from | nan and inf"),
            ("camera", "no camera; add"),
            ("broken", "broken.obj"),
            ("outside", "../good.obj | folder"),
        )),
        ("render good.exr --scene png.hdr --out out.png", "png.hdr: is a PNG picture, and not TOML"),
        ("render good.exr --scene nowhere.toml --out out.png", "nowhere.toml: there is no such file"),
    ),
    # settings
    *_rows(
        *((f"run {name}.toml", f"{name}.toml | {words}") for name, words in (
            ("nowhere", "there is no such file"),
            ("colour", "line 1: colour | capture"),
            ("cuont", "line 3: [sampler] cuont | did you mean count?"),
            ("misplaced", "line 1: count | [sampler]"),
            ("section", "line 1: smapler | did you mean sampler?"),
            ("none", "line 2: [sampler] count = 0 | >= 1"),
            ("text", 'line 2: [sampler] count = "many" | a whole number, not text'),
            ("method", 'line 2: [sampler] method = "trakced" | did you mean tracked?'),
            ("filter", "[sampler] filter adaptive | standard"),
            ("odd", "line 2: [sampler] order = 3 | multiple of 2"),
            ("nan", "line 2: [renderer] exposure = nan"),
            ("near_lamp", "line 2: [renderer.lamp 1] at | nan and inf"),
            ("inf", "line 2: [capture] fps = inf"),
            ("wide", "line 2: [renderer] width = 8193 | 8192"),
            ("no_rig", "[fixtures] rig | nowhere.toml: there is no such file"),
            ("one_camera", "[rig] file | has 1 cameras | [[camera]]"),
            ("no_cameras", "[rig] file | nowhere.toml: there is no such file"),
            ("same_name", "[rig] file | two cameras are called a"),
            ("too_near", "[rig] file | cm from each other"),
            ("turned", "[rig] file | no unit quaternion"),
            ("rates", "[rig] file | camera b | frames a second"),
            ("no_source", "[rig] file | camera b | nowhere"),
            ("live_camera", "[rig] file | camera b: /dev/video0 is live"),
            ("two_sources", "[capture] source | [rig] file"),
            ("no_port", "[wire] ports: has none for capture.a"),
            ("name", '[wire.names] renderer = "viewer.b"'),
            ("elsewhere", "[wire] elsewhere | live"),
            ("wrong_rig", "[fixtures] rig | near.rig.toml: fixture key | within 0.1 m"),
            ("unarmed", "[fixtures] arm | rig = FILE"),
            ("lamps", "[fixtures] rig | vemlight dmx --lights"),
            ("large", "[renderer] width, height: 8192 x 8192"),
            ("tcp", "[wire] | vemlight keys"),
            ("hosts", "[wire.hosts] sampeler | did you mean sampler?"),
            ("lossless", "/dev/video0 | live"),
            ("token", 'line 2: [viewer] token = "short"'),
            ("both", "[viewer] token and insecure"),
            ("port", "line 2: [viewer] port = 70000 | 65000"),
            ("origins", "line 2: [viewer] origins"),
            ("unclosed", "line 2: is not TOML"),
            ("twice", "line 3: is not TOML"),
            ("source", "[capture] source: | nowhere: there is no such file"),
            ("square", "[capture] source: | square.exr: is 16x16"),
            ("no_lens", "[capture] lens: | nowhere.toml: there is no such file"),
            ("format", "RG99"),
            ("start", "[capture] source: | frames 0 to 2"),
            ("record", "[capture] record | vemlight record"),
            ("lamp_alone", "[renderer] lamp: | set [rig] file"),
            ("lamp_file", "[renderer] lamp 1: | text.txt"),
            ("scene", "[renderer] scene: | nowhere.toml: there is no such file"),
            ("mesh", "[renderer] scene: | ghost.obj"),
            ("video", "[renderer] video: | film.avi"),
            ("no_out", "[renderer] video: | --out"),
            ("plate", "[plate] source: | nowhere: there is no such"),
            ("film", "[plate] source: | broken.mp4: is no video"),
            ("keys", "[wire] keys: | nowhere"),
        )),
        ("run good.hdr", "good.hdr: is a Radiance picture | settings | --source good.hdr"),
        ("run sequence", "sequence: is a folder | settings | --source sequence"),
        ("run --source nowhere", "--source: | nowhere: there is no such file"),
        ("run --source /dev/null", "--source: /dev/null: is no camera"),
        ("run --source /dev/video99", "--source: /dev/video99: there is no such camera"),
        ("run --source square.exr", "--source: | square.exr: is 16x16"),
        ("run utf16.toml", "utf16.toml: is text in UTF-16 | UTF-8"),
        ("capture source.toml", "[capture] source: | nowhere: there is no such file"),
        ("plate plate.toml", "[plate] source: | nowhere: there is no such"),
        ("plate", "[plate] source"),
        ("renderer scene.toml", "[renderer] scene: | nowhere.toml: there is no such file"),
        ("sampler cuont.toml", "cuont.toml: line 3 | did you mean count?"),
        ("doctor cuont.toml", "cuont.toml: line 3 | did you mean count?"),
        ("health capture keys.toml", "nowhere | vemlight keys"),
        ("verify nowhere", "nowhere | name the folder of a recording"),
    ),
]  # fmt: skip


def write_wrong_inputs(folder: Path) -> None:
    """Writes the files that the commands of WRONG name."""
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
