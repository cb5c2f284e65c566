"""Meshes of USD (UsdGeomMesh) as primitives of glTF: faces cut into triangles, attributes of any interpolation, subsets with materials."""
# pyright: reportAttributeAccessIssue=false

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from pxr import UsdGeom, UsdShade  # pyright: ignore[reportMissingImports]

from vemlight.renderer.scene.glb_writer import GlbWriter
from vemlight.renderer.scene.polygons import triangulated
from vemlight.renderer.scene.source_mesh import Corners, indexed
from vemlight.renderer.scene.usd_materials import MadeMaterial, UsdMaterials

MAX_CORNERS = 50_000_000  # of a mesh; 4 GB while it is cut
ALL_OF_VERTEX = (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying)


class Attribute(NamedTuple):
    """Values (n, width), and which of them each corner of the faces has, (k,) int64."""

    values: np.ndarray
    corner: np.ndarray


class Faces(NamedTuple):
    """The faces of a mesh without its holes.

    positions: (n, 3). counts: (f,), corners of each. vertex: (k,), of the corners. corner: (k,), which of the file's corners each is.
    face: (f,), which of the file's faces each is.
    """

    positions: np.ndarray
    counts: np.ndarray
    vertex: np.ndarray
    corner: np.ndarray
    face: np.ndarray

    @property
    def face_of_corner(self) -> np.ndarray:
        """Of each corner, which of the file's faces it belongs to."""
        return np.repeat(self.face, self.counts)


class UsdMeshes:
    """Makes meshes of a stage at one time. note: takes lines about what is not drawn as the file has it."""

    def __init__(self, glb: GlbWriter, materials: UsdMaterials, time: Any, note: Callable[[str], None]) -> None:
        self._glb, self._materials, self._time, self._note = glb, materials, time, note

    def mesh(self, prim: Any) -> int | None:
        """The number of a mesh in the glTF; None for one without faces. Raises ValueError for one that cannot be."""
        mesh = UsdGeom.Mesh(prim)
        faces = self._faces(mesh)
        if faces is None:
            return None
        triangles, crossed = triangulated(faces.positions, faces.vertex, faces.counts)
        if crossed:
            self._note(f"{crossed} faces of {prim.GetName()} cross their own edges and may be drawn too large")
        if mesh.GetOrientationAttr().Get(self._time) == UsdGeom.Tokens.leftHanded:
            triangles = triangles[:, ::-1]
        subdivided = mesh.GetSubdivisionSchemeAttr().Get(self._time) != UsdGeom.Tokens.none
        if subdivided and mesh.GetSubdivisionSchemeAttr().HasAuthoredValue():
            self._note("its subdivision surfaces are drawn as their control meshes")
        if mesh.GetPointsAttr().ValueMightBeTimeVarying():
            self._note(f"the points of {prim.GetName()} move; it keeps its first form")
        normals = None if subdivided else self._normals(mesh, faces)
        primitives = []
        owner = np.repeat(np.arange(len(faces.counts)), faces.counts)[triangles[:, 0]]  # the face of each triangle
        for material, chosen in self._parts(prim, faces):
            of_part = triangles if chosen is None else triangles[chosen[owner]]
            if len(of_part):
                primitives.append(self._primitive(prim, faces, of_part, normals, material))
        return self._glb.add("meshes", {"name": prim.GetName(), "primitives": primitives}) if primitives else None

    def _faces(self, mesh: Any) -> Faces | None:
        attributes = mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()
        arrays = [attribute.Get(self._time) for attribute in attributes]
        points, counts, vertex = (np.asarray([] if values is None else values) for values in arrays)
        if not (len(points) and len(counts) and len(vertex)):
            return None
        counts, vertex, positions = counts.astype(np.int64), vertex.astype(np.int64), points.astype(np.float64).reshape(-1, 3)
        if counts.min() < 0 or counts.sum() != len(vertex) or len(vertex) > MAX_CORNERS:
            raise ValueError(f"has {len(vertex)} corners in {mesh.GetPrim().GetName()} where its faces have {counts.sum()}")
        if vertex.min() < 0 or vertex.max() >= len(positions):
            raise ValueError(f"has faces in {mesh.GetPrim().GetName()} with points that it does not have")
        kept = np.ones(len(counts), bool)
        holes = np.asarray(mesh.GetHoleIndicesAttr().Get(self._time) or [], np.int64)
        kept[holes[(holes >= 0) & (holes < len(counts))]] = False
        corner = np.flatnonzero(np.repeat(kept, counts))
        return Faces(positions, counts[kept], vertex[corner], corner, np.flatnonzero(kept))

    def _normals(self, mesh: Any, faces: Faces) -> Attribute | None:
        primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
        if primvar and primvar.HasValue():
            return self._attribute(primvar, faces, 3)
        attr = mesh.GetNormalsAttr()
        if not attr.HasValue():
            return None
        return _of_corners(attr.Get(self._time), None, mesh.GetNormalsInterpolation(), faces, 3)

    def _attribute(self, primvar: Any, faces: Faces, width: int) -> Attribute | None:
        indices = primvar.GetIndices(self._time) if primvar.IsIndexed() else None
        found = _of_corners(primvar.Get(self._time), indices, primvar.GetInterpolation(), faces, width)
        if found is None:
            owner = primvar.GetAttr().GetPrim().GetName()
            self._note(f"{primvar.GetPrimvarName()} of {owner} is left out: it has not as many values as needed")
        return found

    def _parts(self, prim: Any, faces: Faces) -> list[tuple[MadeMaterial | None, np.ndarray | None]]:
        """The materials of a mesh, and for each which faces (f,) have it, None for all."""
        whole = self._materials.made(UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0])
        subsets = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
        if not subsets:
            return [(whole, None)]
        number = np.zeros(int(faces.face.max(initial=0)) + 1, np.int64)
        materials = [whole]
        for subset in subsets:
            chosen = np.asarray(subset.GetIndicesAttr().Get(self._time) or [], np.int64)
            number[chosen[(chosen >= 0) & (chosen < len(number))]] = len(materials)
            materials.append(self._materials.made(UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()[0]))
        return [(material, number[faces.face] == k) for k, material in enumerate(materials)]

    def _primitive(
        self, prim: Any, faces: Faces, triangles: np.ndarray, normals: Attribute | None, material: MadeMaterial | None
    ) -> dict[str, Any]:
        api = UsdGeom.PrimvarsAPI(prim)
        uvs = None
        if material and material.uv_name:
            primvar = api.FindPrimvarWithInheritance(material.uv_name)
            uvs = self._attribute(primvar, faces, 2) if primvar and primvar.HasValue() else None
            if uvs is None:
                self._note(f"{prim.GetName()} has no texture coordinates {material.uv_name[:60]}, of which its material's textures speak")
        colours = None
        if material is None:
            shown = api.FindPrimvarWithInheritance("displayColor")
            colours = self._attribute(shown, faces, 3) if shown and shown.HasValue() else None
        positions, vertex = faces.positions, faces.vertex
        if colours is not None:  # as numbers of corners: any interpolation is one colour for each of them
            positions, vertex = positions[vertex], np.arange(len(vertex))
        rgba = None if colours is None else np.column_stack([colours.values[colours.corner], np.ones(len(vertex))])
        corners = Corners(vertex, None if uvs is None else uvs.corner, None if normals is None else normals.corner)
        none = np.zeros((0, 3))
        made, numbered = indexed(
            corners, triangles, positions, none[:, :2] if uvs is None else uvs.values, none if normals is None else normals.values, rgba
        )
        attributes = {"POSITION": self._glb.accessor(made.positions)}
        if made.normals is not None and normals is not None:
            attributes["NORMAL"] = self._glb.accessor(made.normals)
        if made.uvs is not None and uvs is not None and material:
            flat = np.column_stack([made.uvs, np.ones(len(made.uvs))]) @ material.uv_transform.T
            attributes["TEXCOORD_0"] = self._glb.accessor(flat * [1, -1] + [0, 1])
        if made.colours is not None:
            attributes["COLOR_0"] = self._glb.accessor(np.clip(made.colours.astype(np.float64), 0, 1))
        primitive = {"attributes": attributes, "indices": self._glb.accessor(numbered.reshape(-1))}
        number = material.number if material else self._materials.plain if colours is not None else None
        return primitive if number is None else primitive | {"material": number}


def _of_corners(values: Any, indices: Any, interpolation: str, faces: Faces, width: int) -> Attribute | None:
    """The values of each corner; None where there are not as many as the interpolation takes."""
    rows = np.asarray([] if values is None else values, np.float64)
    if rows.size == 0 or rows.size % width:
        return None
    rows = rows.reshape(-1, width)
    if interpolation == UsdGeom.Tokens.faceVarying:
        place = faces.corner
    elif interpolation in ALL_OF_VERTEX:
        place = faces.vertex
    elif interpolation == UsdGeom.Tokens.uniform:
        place = faces.face_of_corner
    else:
        place = np.zeros(len(faces.vertex), np.int64)
    if indices is not None:
        numbers = np.asarray(indices, np.int64)
        if place.max(initial=0) >= len(numbers):
            return None
        place = numbers[place]
    if place.min(initial=0) < 0 or place.max(initial=0) >= len(rows) or not np.isfinite(rows).all():
        return None
    return Attribute(rows, place)
