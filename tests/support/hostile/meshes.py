"""Meshes: glTF, OBJ, PLY and STL, each read as the mesh of a scene file."""

import json
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


def _gltf(**document: object) -> bytes:
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
    for name in (
        "/dev/zero",
        "../../../../../../dev/zero",
        "file:///dev/zero",
        "http://127.0.0.1:9/a.bin",
        "/etc/passwd",
        "%2e%2e/%2e%2e/etc/passwd",
    ):
        bombs[f"buffer {name}"] = _gltf(**{**sound, "buffers": [{"byteLength": 36, "uri": name}]})
        image = {
            "images": [{"uri": name}],
            "textures": [{"source": 0}],
            "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        }
        primitive = {"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 0}, "material": 0}]}
        bombs[f"image {name}"] = _gltf(**{**sound, **image, "meshes": [primitive]})
    bombs["depth"] = b'{"asset": ' + b"[" * 100_000
    bombs["long text"] = _gltf(extras="x" * 10**7)
    return bombs


def _obj_bombs() -> dict[str, bytes]:
    many = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    bombs = {
        "one face of 100,000 corners": many + b"f" + b" 1 2 3" * 33_333,
        "index": many + b"f 1 2 99999999999\n",
        "negative": many + b"f -1 -2 -9\n",
    }
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


FORMATS = {
    "gltf": Format(".gltf", _gltf_files, _read_mesh, _gltf_bombs),
    "obj": Format(".obj", _exported(".obj"), _read_mesh, _obj_bombs),
    "ply": Format(".ply", _exported(".ply"), _read_mesh, _ply_bombs),
    "stl": Format(".stl", _exported(".stl"), _read_mesh, _stl_bombs),
}
