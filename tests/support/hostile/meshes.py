"""Meshes: glTF, OBJ, PLY and STL, each read as the mesh of a scene file."""

import base64
import json
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.hostile.format import Format


def _textured() -> Any:
    import trimesh
    from PIL import Image
    from trimesh.visual import TextureVisuals

    box = trimesh.creation.box()
    image = Image.fromarray(np.random.default_rng(0).integers(0, 256, (8, 8, 3), np.uint8))
    box.visual = TextureVisuals(uv=box.vertices[:, :2] + 0.5, image=image)
    return box


def _exported(*suffixes: str) -> Callable[[Path], list[Path]]:
    def whole(folder: Path) -> list[Path]:
        import trimesh

        paths = []
        for k, suffix in enumerate(suffixes):
            mesh = _textured() if suffix in (".glb", ".obj") else trimesh.creation.icosphere(subdivisions=1)
            paths.append(folder / f"mesh{k}{suffix}")
            data = mesh.export(file_type=suffix[1:]) if suffix != ".stl_ascii" else trimesh.creation.box().export(file_type="stl_ascii")
            paths[-1].write_bytes(data.encode() if isinstance(data, str) else data)
        return paths

    return whole


def _gltf_files(folder: Path) -> list[Path]:
    from tests.support.gltf_files import CORNERS, GltfFile

    file = GltfFile()
    file.document["meshes"] = [
        {"primitives": [{"attributes": {"POSITION": file.accessor(CORNERS)}, "indices": file.accessor(np.arange(3, dtype=np.uint16))}]}
    ]
    file.document["nodes"] = [{"mesh": 0, "rotation": [0.0, 0.0, 0.0, 1.0]}]
    return [file.write(folder / "a.gltf"), file.write(folder / "b.glb"), *_exported(".glb")(folder)]


def _with_lengths(content: bytes) -> bytes:
    """A .glb whose header and chunks have the right lengths."""
    binary = content.rfind(b"BIN\0")
    if content[:4] != b"glTF" or binary < 28:
        return content
    data = bytearray(content)
    struct.pack_into("<I", data, 8, len(data))
    struct.pack_into("<I", data, 12, binary - 4 - 20)
    struct.pack_into("<I", data, binary - 4, len(data) - binary - 4)
    return bytes(data)


def _gltf(**document: object) -> bytes:
    head = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}]}
    return json.dumps({**head, **document}).encode()


def _gltf_bombs() -> dict[str, bytes]:
    many = [{"mesh": 0} for _ in range(60_000)]
    deep = [{"children": [k + 1]} for k in range(20_000)] + [{"mesh": 0}]
    bombs = {f"{count} rows without data": _rows(count) for count in (49_000_000, 2**20, 10**12, -1)}
    bombs |= {f"{count} rows of a small buffer": _rows(count, bufferView=0) for count in (49_000_000, 10**9)}
    bombs["60,000 nodes"] = _gltf(**{**SOUND, "nodes": many, "scenes": [{"nodes": list(range(60_000))}]})
    bombs["4,000 nodes"] = _gltf(**{**SOUND, "nodes": many[:4000], "scenes": [{"nodes": list(range(4000))}]})
    bombs["200,000 nodes without mesh"] = _gltf(
        **{**SOUND, "nodes": [{"mesh": 0}] + 200_000 * [{}], "scenes": [{"nodes": list(range(200_001))}]}
    )
    bombs["60,000 skins"] = _gltf(**{**SOUND, "nodes": [{"mesh": 0}] + [{"skin": k, "name": str(k)} for k in range(60_000)]})
    bombs["60,000 extensions of 10,000 materials"] = _gltf(
        **SOUND, extensionsUsed=[f"X_{k}" for k in range(60_000)], materials=[{"extensions": {"X_1": {}}} for _ in range(10_000)]
    )
    bombs["20,000 generations"] = _gltf(**{**SOUND, "nodes": deep})
    chain = [{"children": [k + 1], "mesh": 0} for k in range(250)] + [{"mesh": 0}]
    bombs["a chain of meshes"] = _gltf(**{**SOUND, "nodes": chain})
    bombs["a node its own child"] = _gltf(**{**SOUND, "nodes": [{"children": [0], "mesh": 0}]})
    bombs["doubling"] = _gltf(**{**SOUND, "nodes": [*({"children": [k + 1, k + 1]} for k in range(40)), {"mesh": 0}]})
    bombs["10^7 values"] = b'{"asset": {"version": "2.0"}, "extras": [' + b"[]," * 10**7 + b"0]}"
    bombs["depth"] = b'{"asset": ' + b"[" * 100_000
    bombs["long text"] = _gltf(extras="x" * 10**7)
    bombs["digits"] = b'{"asset": {"version": 2' + b"9" * 10**7 + b"}}"
    return {**bombs, **_gltf_references(), **_gltf_instances(), **_gltf_textures(), **_gltf_animations()}


def _rows(count: int, **more: object) -> bytes:
    return _gltf(**VIEW, **MESH, accessors=[{"componentType": 5126, "count": count, "type": "VEC3", **more}])


TRIANGLE = "data:application/octet-stream;base64," + "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"
VIEW = {"buffers": [{"byteLength": 36, "uri": TRIANGLE}], "bufferViews": [{"buffer": 0, "byteLength": 36}]}
MESH = {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}
SOUND: dict[str, Any] = {**VIEW, **MESH, "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]}
REFERENCES = (
    "/dev/zero",
    "../../../../../../dev/zero",
    "file:///dev/zero",
    "http://127.0.0.1:9/a",
    "/etc/passwd",
    "%2e%2e/%2e%2e/etc/passwd",
)


def _gltf_references() -> dict[str, bytes]:
    bombs = {}
    for name in REFERENCES:
        bombs[f"buffer {name}"] = _gltf(**{**SOUND, "buffers": [{"byteLength": 36, "uri": name}]})
        bombs[f"image {name}"] = _textured_gltf([{"uri": name}])
    return bombs


def _textured_gltf(images: list[dict[str, object]], **material: object) -> bytes:
    textures = [{"source": k} for k in range(len(images))]
    materials = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": k}}, "normalTexture": {"index": k, "scale": 0.5 + k}, **material}
        for k in range(len(images))
    ]
    primitives = [{"attributes": {"POSITION": 0, "TEXCOORD_0": 0}, "material": k} for k in range(len(images))]
    return _gltf(**{**SOUND, "images": images, "textures": textures, "materials": materials, "meshes": [{"primitives": primitives}]})


def _gltf_instances() -> dict[str, bytes]:
    """Many triangles, again and again."""
    rng = np.random.default_rng(0)
    data = rng.random((20_000, 3)).astype("<f4").tobytes() + rng.integers(0, 20_000, 60_000).astype("<u2").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    base = {
        "buffers": [{"byteLength": len(data), "uri": uri}],
        "bufferViews": [{"buffer": 0, "byteLength": 240_000}, {"buffer": 0, "byteOffset": 240_000, "byteLength": 120_000}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 20_000, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 60_000, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    }
    bombs = {}
    for count, node in ((4000, {}), (4000, {"scale": [1.0, 2.0, 3.0]}), (40, {"scale": [1.0, 2.0, 3.0]}), (300, {})):
        nodes = [{"mesh": 0, **node} for _ in range(count)]
        bombs[f"{count} times 20,000 triangles {node}"] = _gltf(**{**base, "nodes": nodes, "scenes": [{"nodes": list(range(count))}]})
    primitive: dict[str, Any] = {"attributes": {"POSITION": 0}, "indices": 1}
    bombs["4,000 primitives of the same triangles"] = _gltf(**{**base, "meshes": [{"primitives": [primitive] * 4000}]})
    accessors = [{"bufferView": 0, "componentType": 5126, "count": 20_000, "type": "VEC3"} for _ in range(4000)]
    primitives = [{"attributes": {"POSITION": k}} for k in range(4000)]
    bombs["4,000 accessors of the same bytes"] = _gltf(**{**base, "accessors": accessors, "meshes": [{"primitives": primitives}]})
    return bombs


def _gltf_textures() -> dict[str, bytes]:
    from tests.support.hostile.images import png

    def uri(content: bytes) -> str:
        return "data:image/png;base64," + base64.b64encode(content).decode()

    plain, clear = png(4096, 4096), png(4096, 4096, colour=6)
    return {
        "a texture of 20,000": _textured_gltf([{"uri": uri(png(20_000, 20_000))}]),
        "a plain texture of 4096": _textured_gltf([{"uri": uri(plain)}]),
        "20 plain textures of 4096": _textured_gltf([{"uri": uri(plain)}] * 20),
        "a clear texture of 4096, blended": _textured_gltf([{"uri": uri(clear)}], alphaMode="BLEND"),
        "200 textures of 512": _textured_gltf([{"uri": uri(png(512, 512))}] * 200),
    }


def _gltf_animations() -> dict[str, bytes]:
    times = np.arange(1000, dtype="<f4").tobytes() + bytes(16_000)
    uri = "data:application/octet-stream;base64," + base64.b64encode(times).decode()
    base = {
        "buffers": [*VIEW["buffers"], {"byteLength": len(times), "uri": uri}],
        "bufferViews": [*VIEW["bufferViews"], {"buffer": 1, "byteLength": 4000}, {"buffer": 1, "byteOffset": 4000, "byteLength": 12_000}],
        "accessors": [
            *SOUND["accessors"],
            {"bufferView": 1, "componentType": 5126, "count": 1000, "type": "SCALAR"},
            {"bufferView": 2, "componentType": 5126, "count": 1000, "type": "VEC3"},
        ],
        **MESH,
    }
    bombs = {}
    for nodes, depth in ((4000, 1), (700, 1), (10, 200), (3, 250)):
        tree = [
            {"children": [depth + k for k in range(nodes)]},
            *({"children": [k]} for k in range(depth - 1)),
            *({"mesh": 0} for _ in range(nodes)),
        ]
        channels = [{"sampler": 0, "target": {"node": k, "path": "translation"}} for k in range(len(tree))]
        animation = {"samplers": [{"input": 1, "output": 2}], "channels": channels}
        scenes = [{"nodes": [depth - 1 if depth > 1 else 0]}]
        bombs[f"{nodes} moving meshes below {depth} nodes"] = _gltf(**{**base, "nodes": tree, "scenes": scenes, "animations": [animation]})
    return bombs


def _obj_bombs() -> dict[str, bytes]:
    few = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    bombs = {
        "one face of 100,000 corners": few + b"f" + b" 1 2 3" * 33_333,
        "index": few + b"f 1 2 99999999999\n",
        "index of 50 million": few + b"f 1 2 50000000\n",
        "index of 50 million with others": few + b"vt 0 0\nf 1/1 2/1 50000000/1\n",
        "index of 50 million, continued": few + b"vt 0 0\nf 1/1 2/1 \\\n50000000/1\n",
        "texture index": few + b"vt 0 0\nf 1/1 2/1 3/50000000\n",
        "normal index": few + b"vn 0 0 1\nf 1//1 2//1 3//50000000\n",
        "negative": few + b"f -1 -2 -9\n",
        "negative of 50 million": few + b"vt 0 0\nf 1/1 2/1 -50000000/1\n",
        "mixed faces": few + b"f 1 2 3\nf 1 2 3 1\n" * 100_000,
        "long lines": few + b"f 1 2 3" + b" " * 10**7 + b"\n",
        "continuations": few + b"f 1 2 \\\n" * 300_000 + b"3\n",
        "digits": b"v " + b"1" * 10**6 + b" 0 0\n",
        "lines": b"\n" * 10**7,
        "comments": b"# x\n" * 2_000_000 + few + b"f 1 2 3\n",
        "vertices without faces": b"v 0 0 0\n" * 10**6,
        "vertices of many numbers": b"v" + b" 1" * 10**6 + b"\nf 1 1 1\n",
        "groups": few + b"".join(b"g %d\nf 1 2 3\n" % k for k in range(60_000)),
        "objects": few + b"".join(b"o %d\nf 1 2 3\n" % k for k in range(60_000)),
        "60,000 materials": few + b"".join(b"usemtl %d\nf 1 2 3\n" % k for k in range(60_000)),
        "4,000 materials": few + b"".join(b"usemtl %d\nf 1 2 3\n" % k for k in range(4000)),
        "4,000 materials on 50,000 vertices": few + b"v 0 0 1\n" * 50_000 + b"".join(b"usemtl %d\nf 1 2 3\n" % k for k in range(4000)),
        "the same material 100,000 times": few + b"usemtl a\nf 1 2 3\n" * 100_000,
        "huge numbers": b"v 1e308 0 0\nv -1e308 0 0\nv 0 1e308 0\nf 1 2 3\n",
        "nan": few + b"vt nan nan\nf 1/1 2/1 3/1\n",
        "empty": b"",
        "NUL": bytes(10**6),
    }
    for name in (
        b"/dev/zero",
        b"../../../../../../dev/zero",
        b"/etc/passwd",
        b"http://127.0.0.1:9/a.mtl",
        b"file:///dev/zero",
        b"x" * 5000,
    ):
        bombs[f"material {name.decode()[:40]}"] = b"mtllib " + name + b"\nusemtl a\n" + few + b"f 1 2 3\n"
    return bombs


OBJ_OF_MTL = b"mtllib file.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"
MTL = b"newmtl a\nKd 0.5 0.4 0.3\nKs 0.1 0.1 0.1\nNs 20\nmap_Kd file.png\n\nnewmtl b\nKd 1 1 1\n"


def _mtl_files(folder: Path) -> list[Path]:
    from tests.support.hostile.images import png

    (folder / "file.png").write_bytes(png(64, 64))
    (folder / "big.png").write_bytes(png(16_385, 16))
    (folder / "wide.png").write_bytes(png(4096, 4096))
    os.mkfifo(folder / "pipe")
    (folder / "a.mtl").write_bytes(MTL)
    return [folder / "a.mtl"]


def _mtl_bombs() -> dict[str, bytes]:
    names = (
        *(name.encode() for name in REFERENCES),
        b"pipe",
        b"big.png",
        b"wide.png",
        b"missing.png",
        b".",
        b"",
        b"-s 2 2 2 file.png",
        b"x" * 5000,
    )
    bombs = {f"map_Kd {name.decode()[:40]}": b"newmtl a\nmap_Kd " + name + b"\n" for name in names}
    bombs |= {f"other map {name}": b"newmtl a\nmap_%s /dev/zero\n" % name.encode() for name in ("Ks", "Bump", "d", "Ka")}
    bombs["20,000 materials of an image"] = (
        b"".join(b"newmtl %d\nmap_Kd wide.png\n" % k for k in range(20_000)) + b"newmtl a\nmap_Kd wide.png\n"
    )
    bombs["200,000 materials"] = b"".join(b"newmtl %d\nKd 1 1 1\n" % k for k in range(200_000))
    bombs["10^6 blank lines"] = b"\n" * 10**6 + MTL
    bombs["images before materials"] = b"map_Kd file.png\n" * 20_000
    bombs["numbers"] = b"newmtl a\nKd" + b" 1" * 10**6 + b"\n"
    bombs["nan"] = b"newmtl a\nKd nan nan nan\n"
    bombs["infinity"] = b"newmtl a\nKd inf -inf 1e999\n"
    bombs["one number"] = b"newmtl a\nKd 1\n"
    bombs["no numbers"] = b"newmtl a\nKd x y z\n"
    bombs["long"], bombs["NUL"], bombs["empty"] = b"newmtl " + b"a" * 5 * 10**6, bytes(10**6), b""
    return bombs


def _read_mtl(path: Path) -> object:
    path.with_suffix(".obj").write_bytes(OBJ_OF_MTL)
    return read_mesh(path.with_suffix(".obj"))


def _ply_bombs() -> dict[str, bytes]:
    def head(vertices: int, faces: int, form: bytes = b"binary_little_endian", more: bytes = b"") -> bytes:
        text = b"ply\nformat %s 1.0\n%selement vertex %d\nproperty float x\nproperty float y\nproperty float z\n" % (form, more, vertices)
        return text + b"element face %d\nproperty list uchar int vertex_indices\nend_header\n" % faces

    counts = ((10**9, 1), (10**15, 1), (3, 10**9), (-1, -1), (0, 0), (3, 10**15), (2**63, 1), (10**7, 0))
    bombs = {f"{vertices} vertices, {faces} faces": head(vertices, faces) + bytes(100) for vertices, faces in counts}
    bombs |= {f"ascii {vertices}": head(vertices, 1, b"ascii") for vertices in (10**9, 10**12)}
    bombs |= {f"ascii, {faces} faces": head(3, faces, b"ascii") + b"0 0 0\n1 0 0\n0 1 0\n" + b"3 0 1 2\n" * 9 for faces in (10**9, 10**12)}
    for name in REFERENCES:
        bombs[f"texture {name}"] = (
            head(3, 1, more=b"comment TextureFile " + name.encode() + b"\n") + bytes(36) + b"\3" + struct.pack("<3i", 0, 1, 2)
        )
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    for index in (2**31 - 1, -1, 3):
        bombs[f"index {index}"] = head(3, 1) + corners + b"\3" + struct.pack("<3i", 0, 1, index)
    bombs["faces of 255 corners"] = head(3, 3000) + corners + (b"\xff" + bytes(4 * 255)) * 3000
    bombs["lists of lists"] = head(3, 1, more=b"element a 1000000\nproperty list uint uint x\n") + b"\xff" * 1000
    bombs["many elements"] = head(3, 1, more=b"element a 0\n" * 100_000) + corners + b"\3" + struct.pack("<3i", 0, 1, 2)
    bombs["many properties"] = head(3, 1, more=b"element a 1\n" + b"property double x\n" * 100_000)
    bombs["unknown type"] = head(3, 1, more=b"element a 1\nproperty quad x\n")
    bombs["huge"] = head(3, 1) + np.full(9, 3e38, "<f4").tobytes() + b"\3" + struct.pack("<3i", 0, 1, 2)
    bombs["nan"] = head(3, 1) + np.full(9, np.nan, "<f4").tobytes() + b"\3" + struct.pack("<3i", 0, 1, 2)
    bombs["no end"] = b"ply\nformat ascii 1.0\n" + b"comment x\n" * 10**6
    bombs["empty"], bombs["magic"] = b"", b"ply\n"
    return bombs


def _stl_bombs() -> dict[str, bytes]:
    def facets(count: int, *numbers: bytes) -> bytes:
        vertices = b"".join(b"vertex " + number + b"\n" for number in numbers)
        return b"solid a\n" + (b"facet normal 0 0 1\nouter loop\n" + vertices + b"endloop\nendfacet\n") * count + b"endsolid a\n"

    one = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    bombs = {f"{count} triangles": bytes(80) + struct.pack("<I", count) + bytes(50) for count in (2**32 - 1, 10**8, 2, 0, 1)}
    bombs |= {f"{count} triangles, one there": bytes(80) + struct.pack("<I", count) + one for count in (2**32 - 1, 10**8, 2, 0)}
    bombs |= {
        f"{value} as number": bytes(80) + struct.pack("<I", 1) + struct.pack("<12fH", *([value] * 12), 0)
        for value in (np.nan, np.inf, 3e38)
    }
    bombs["the same triangle 20,000 times"] = bytes(80) + struct.pack("<I", 20_000) + one * 20_000
    bombs["ascii"] = b"solid a\n" + b"facet normal 0 0 1\nouter loop\n" * 300_000
    bombs |= {
        f"ascii with {name}": facets(1, *numbers)
        for name, numbers in {
            "nan": (b"nan nan nan",) * 3,
            "text": (b"a b c",) * 3,
            "no corners": (),
            "one corner": (b"0 0 0",),
            "five corners": (b"0 0 0",) * 5,
            "digits": (b"1" * 10**6 + b" 0 0", b"0 1 0", b"0 0 1"),
            "huge": (b"1e308 0 0", b"0 1e308 0", b"0 0 1e308"),
            "few numbers": (b"0", b"1", b"2"),
            "many numbers": (b"0 " * 10**5,) * 3,
        }.items()
    }
    bombs["ascii, the same triangle 20,000 times"] = facets(20_000, b"0 0 0", b"1 0 0", b"0 1 0")
    bombs["many solids"] = facets(1, b"0 0 0", b"1 0 0", b"0 1 0") * 5000
    bombs["long name"] = b"solid " + b"x" * 10**7
    bombs["only words"] = b"vertex " * 10**6
    bombs["binary that begins with solid"] = b"solid".ljust(80) + struct.pack("<I", 1) + one
    bombs["empty"], bombs["NUL"], bombs["header"] = b"", bytes(10**6), bytes(84)
    return bombs


def read_mesh(path: Path) -> object:
    """Reads a file as the mesh of a scene."""
    scene = path.with_suffix(".toml")
    scene.write_text(f'[camera]\nfrom = [3.0, -4.0, 2.5]\nat = [0.0, 0.0, 0.5]\n[[mesh]]\nfile = "{path.name}"\n')
    from vemlight.renderer.scene.scene import load_scene

    return load_scene(scene)


FORMATS = {
    "gltf": Format(".gltf", _gltf_files, read_mesh, _gltf_bombs, _with_lengths),
    "obj": Format(".obj", _exported(".obj"), read_mesh, _obj_bombs),
    "mtl": Format(".mtl", _mtl_files, _read_mtl, _mtl_bombs),
    "ply": Format(".ply", _exported(".ply"), read_mesh, _ply_bombs),
    "stl": Format(".stl", _exported(".stl"), read_mesh, _stl_bombs),
}
