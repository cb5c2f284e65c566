"""`python -m vemlight.renderer.scene.usd_convert FILE`: a USD scene as a line of JSON and a .glb on standard output.

Runs in a process of its own, with limits (usd_files.py). Status 2 and {"refused": ...} for a scene that is refused.
"""
# pyright: reportAttributeAccessIssue=false

import json
import os
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Usd, UsdGeom  # pyright: ignore[reportMissingImports]

from vemlight.errors import UserError
from vemlight.files import one_line
from vemlight.renderer.scene.files_beside import MAX_LINES
from vemlight.renderer.scene.glb_writer import GlbWriter
from vemlight.renderer.scene.gltf import MAX_BYTES
from vemlight.renderer.scene.gltf_nodes import MAX_NODES
from vemlight.renderer.scene.usd_files import REFUSED
from vemlight.renderer.scene.usd_layers import CheckedLayers
from vemlight.renderer.scene.usd_materials import UsdMaterials
from vemlight.renderer.scene.usd_meshes import UsdMeshes

FREE_BYTES, BYTES_PER_BYTE = 3 * 2**30, 20  # of memory, addresses included: usd-core itself takes one gigabyte of them
MAX_CPU_S = 500
MAX_KEYFRAMES = 10_000  # of a mesh
SHEAR = 1e-4  # of a matrix, by which its axes may be off a right angle and it still counts as scale and rotation. 1e-6 to 1e-3 do
Y_UP_FROM_Z_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # glTF's axes


class Scene:
    """The conversion of one stage."""

    def __init__(self, path: Path) -> None:
        self.left_out: list[str] = []
        self.layers = CheckedLayers(path, self.note)
        self._stage = self.layers.stage()
        ranged = self._stage.HasAuthoredTimeCodeRange() and self._stage.GetEndTimeCode() > self._stage.GetStartTimeCode()
        self._start = self._stage.GetStartTimeCode() if ranged else None
        self._time = Usd.TimeCode.EarliestTime() if self._start is None else Usd.TimeCode(self._start)
        self._glb = GlbWriter()
        self._meshes = UsdMeshes(self._glb, UsdMaterials(self._glb, self.layers, self._time, self.note), self._time, self.note)
        self._numbers: dict[str, int | None] = {}
        self._places = UsdGeom.XformCache(self._time)
        metres = UsdGeom.GetStageMetersPerUnit(self._stage)
        if not 1e-9 < metres < 1e9:
            raise UserError(f"has metersPerUnit = {metres:g}; correct it")
        if (up := UsdGeom.GetStageUpAxis(self._stage)) not in (UsdGeom.Tokens.y, UsdGeom.Tokens.z):
            raise UserError(f"has upAxis = {str(up)[:20]}, and Y and Z are read; correct it")
        turned = Y_UP_FROM_Z_UP if up == UsdGeom.Tokens.z else np.eye(4)
        self._root = turned * [metres, metres, metres, 1.0]

    def note(self, line: str) -> None:
        """Adds a line about what is not drawn, once."""
        line = " ".join(line.split())[:300]
        if len(self.left_out) < MAX_LINES and line not in self.left_out:
            self.left_out.append(line)

    def glb(self) -> bytes:
        """The stage as glTF."""
        prims = iter(Usd.PrimRange(self._stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
        for seen, prim in enumerate(prims):
            if seen > 10 * MAX_NODES:
                raise UserError(f"has more than {10 * MAX_NODES} prims; flatten it")
            if prim.IsA(UsdGeom.Imageable) and not self._is_shown(prim):
                prims.PruneChildren()
            elif prim.IsA(UsdGeom.PointInstancer):
                self._point_instances(prim)
                prims.PruneChildren()
            elif prim.IsA(UsdGeom.Mesh):
                self._mesh(prim)
            elif prim.IsA(UsdGeom.Camera):
                self._camera(prim)
            elif prim.IsA(UsdGeom.Gprim):
                self.note(f"{prim.GetName()} is left out: {prim.GetTypeName()} is not drawn; make it a mesh")
            elif "Light" in str(prim.GetTypeName()):
                self.note("its lights are not drawn; give the scene a [[luminaire]]")
        return self._glb.content()

    def _is_shown(self, prim: Any) -> bool:
        shown = UsdGeom.Imageable(prim)
        is_of_pictures = shown.ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
        return is_of_pictures and shown.ComputeVisibility(self._time) != UsdGeom.Tokens.invisible

    def _number(self, prim: Any) -> int | None:
        """The glTF's mesh of a prim; instances share their prototype's."""
        key = str((prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath())
        if key not in self._numbers:
            self._numbers[key] = self._meshes.mesh(prim)
            if self._numbers[key] is None:
                self.note(f"{prim.GetName()} is left out: it is empty")
        return self._numbers[key]

    def _place(self, prim: Any) -> np.ndarray:
        """The transform (4, 4) from a prim's axes to the glTF's."""
        return self._root @ np.array(self._places.GetLocalToWorldTransform(prim)).T

    def _node(self, row: dict[str, Any]) -> int:
        number = self._glb.add("nodes", row)
        if number >= MAX_NODES:
            raise UserError(f"draws more than {MAX_NODES} meshes and instances; join them")
        self._glb.document["scenes"][0]["nodes"].append(number)
        return number

    def _mesh(self, prim: Any) -> None:
        number = self._number(prim)
        if number is None:
            return
        name, moving = prim.GetName(), self._keyframes(prim)
        if moving is None:
            self._node({"name": name, "mesh": number, "matrix": self._place(prim).T.reshape(-1).tolist()})
            return
        times_s, parts = moving
        row = {"name": name, "mesh": number} | {key: values[0].tolist() for key, values in parts.items()}
        node = self._node(row)
        if "animations" not in self._glb.document:
            self._glb.add("animations", {"name": "timeline", "samplers": [], "channels": []})
        animation, clock = self._glb.document["animations"][0], self._glb.accessor(times_s)
        for key, values in parts.items():
            animation["samplers"].append({"input": clock, "output": self._glb.accessor(values), "interpolation": "LINEAR"})
            animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": {"node": node, "path": key}})

    def _keyframes(self, prim: Any) -> tuple[np.ndarray, dict[str, np.ndarray]] | None:
        """Times from the start in s, and translation, rotation and scale at each, of a prim that moves; None for one that does not."""
        if self._start is None or prim.IsInstanceProxy():
            return None
        codes: set[float] = set()
        above = prim
        while above and not above.IsPseudoRoot():
            if above.IsA(UsdGeom.Xformable) and UsdGeom.Xformable(above).TransformMightBeTimeVarying():
                span = Gf.Interval(self._start, self._stage.GetEndTimeCode())
                codes.update(UsdGeom.Xformable(above).GetTimeSamplesInInterval(span))
            above = above.GetParent()
        if len(codes) < 2:
            return None
        if len(codes) > MAX_KEYFRAMES:
            raise UserError(f"has more than {MAX_KEYFRAMES} time samples of {prim.GetName()}; thin them out")
        times = sorted({self._start, *codes})
        matrices = [self._root @ np.array(UsdGeom.Imageable(prim).ComputeLocalToWorldTransform(Usd.TimeCode(t))).T for t in times]
        parts = _parts(np.array(matrices))
        if parts is None:
            self.note(f"{prim.GetName()} moves with shear or a scale of 0; it stands still")
            return None
        return (np.array(times) - self._start) / self._stage.GetTimeCodesPerSecond(), parts

    def _point_instances(self, prim: Any) -> None:
        instancer = UsdGeom.PointInstancer(prim)
        numbers = instancer.GetProtoIndicesAttr().Get(self._time)
        roots = [self._stage.GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetForwardedTargets()]
        if numbers is None or not roots:
            return
        if len(numbers) > MAX_NODES:
            raise UserError(f"has {len(numbers)} instances in {prim.GetName()}, more than {MAX_NODES}; leave some out")
        matrices = instancer.ComputeInstanceTransformsAtTime(
            self._time, self._time, UsdGeom.PointInstancer.IncludeProtoXform, UsdGeom.PointInstancer.IgnoreMask
        )
        mask = instancer.ComputeMaskAtTime(self._time) or [True] * len(numbers)
        parts: dict[int, list[tuple[int, np.ndarray]]] = {}
        for k, root in enumerate(roots):
            inverse = self._places.GetLocalToWorldTransform(root).GetInverse() if root else None
            parts[k] = [
                (number, np.array(self._places.GetLocalToWorldTransform(part) * inverse).T)
                for part in (Usd.PrimRange(root, Usd.TraverseInstanceProxies()) if root else ())
                if part.IsA(UsdGeom.Mesh) and (number := self._number(part)) is not None
            ]
        place = self._place(prim)
        for number, matrix, shown in zip(numbers, matrices, mask, strict=False):
            for mesh, of_root in parts.get(number, []) if shown else []:
                whole = place @ np.array(matrix).T @ of_root
                self._node({"name": prim.GetName(), "mesh": mesh, "matrix": whole.T.reshape(-1).tolist()})

    def _camera(self, prim: Any) -> None:
        camera = UsdGeom.Camera(prim).GetCamera(self._time)
        if camera.projection != Gf.Camera.Perspective:
            row: dict[str, Any] = {"type": "orthographic", "orthographic": {"xmag": 1.0, "ymag": 1.0, "znear": 0.1, "zfar": 100.0}}
        else:
            fov_y = np.radians(camera.GetFieldOfView(Gf.Camera.FOVVertical))
            row = {"type": "perspective", "perspective": {"yfov": float(fov_y), "znear": 0.1}}
        matrix = self._place(prim)
        matrix[:3, :3] /= np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-30)
        number = self._glb.add("cameras", row)
        self._node({"name": prim.GetName(), "camera": number, "matrix": matrix.T.reshape(-1).tolist()})


def _parts(matrices: np.ndarray) -> dict[str, np.ndarray] | None:
    """Translation, rotation (quaternion x, y, z, w) and scale of transforms (n, 4, 4); None where one has shear or no size."""
    from scipy.spatial.transform import Rotation

    linear = matrices[:, :3, :3]
    scale = np.linalg.norm(linear, axis=1)
    if not np.isfinite(matrices).all() or scale.min() <= 0:
        return None
    mirrored = np.linalg.det(linear) < 0
    scale[mirrored, 0] *= -1
    rotation = linear / scale[:, None, :]
    if np.abs(np.einsum("nki,nkj->nij", rotation, rotation) - np.eye(3)).max() > SHEAR:
        return None
    turns = Rotation.from_matrix(rotation).as_quat()
    for k in range(1, len(turns)):  # the short way round
        turns[k] *= np.sign(turns[k] @ turns[k - 1]) or 1.0
    return {"translation": matrices[:, :3, 3], "rotation": turns, "scale": scale}


def _limit(path: Path) -> None:
    """Keeps this process within memory, time and output that the file may ask for."""
    stored = sum(file.stat().st_size for file in [path] if file.is_file())
    for what, most in (
        (resource.RLIMIT_AS, FREE_BYTES + BYTES_PER_BYTE * stored), (resource.RLIMIT_CPU, MAX_CPU_S), (resource.RLIMIT_FSIZE, MAX_BYTES),
        (resource.RLIMIT_CORE, 0),
    ):  # fmt: skip
        _, hard = resource.getrlimit(what)
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def main(path: Path) -> int:
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(2, 1)  # what usd-core says is no part of the scene
        _limit(path)
        try:
            scene = Scene(path)
            glb = scene.glb()
        except UserError as error:
            report, glb, status = {"refused": " ".join(str(error).split())}, b"", REFUSED
        except Exception as error:  # a hostile file raises whatever usd-core and what is made of it trip over
            report, glb, status = {"refused": f"cannot be read ({one_line(error)}); export it again"}, b"", REFUSED
        else:
            report, status = {"stored_bytes": scene.layers.stored_bytes, "left_out": scene.left_out}, 0
        out.write(json.dumps(report).encode() + b"\n" + glb)
    return status


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
