"""OBJ files: faces of any number of corners, with the materials of their .mtl (Wavefront, "Object Files", appendix B1).

Library readers such as trimesh's cut concave faces as fans, count negative numbers from the file's end, lose tabs and drop Kd beside an
image, all without a word.
"""

import re
import warnings

import numpy as np

from vemlight.files import MAX_SHOWN
from vemlight.light.colour import linear_from_srgb
from vemlight.renderer.scene.files_beside import FilesBeside
from vemlight.renderer.scene.materials import Phong
from vemlight.renderer.scene.mtl_files import MtlMaterial, phong_from_mtl, read_mtl
from vemlight.renderer.scene.polygons import triangulated
from vemlight.renderer.scene.scene_limits import MAX_MESHES
from vemlight.renderer.scene.source_mesh import Corners, FileMeshes, SourceMesh, indexed

INDEX = rb"[-+]?\d{1,10}"
# One word for each corner: position, position/texture, position/texture/normal, position//normal; all of a file alike as a rule.
UNIFORM = {
    (1, 0, 0): re.compile(rb"(?: %b)*+" % INDEX),
    (1, 1, 0): re.compile(rb"(?: %b/%b)*+" % (INDEX, INDEX)),
    (1, 1, 1): re.compile(rb"(?: %b/%b/%b)*+" % (INDEX, INDEX, INDEX)),
    (1, 0, 1): re.compile(rb"(?: %b//%b)*+" % (INDEX, INDEX)),
}
COMMENT = re.compile(rb"^((?:v|vt|vn|f) [^\n#]*)#[^\n]*", re.MULTILINE)  # names of materials may have a #
NOT_DRAWN = {b"l ": "lines", b"p ": "points", b"cu": "curves", b"su": "surfaces"}


class _Statements:
    """The statements of a file, one a line, by their kinds."""

    def __init__(self, content: bytes) -> None:
        text = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n").replace(b"\\\n", b" ").translate(bytes.maketrans(b"\t\v\f", b"   "))
        if b"  " in text:
            text = re.sub(rb" ++", b" ", text)
        text = text.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")
        if b"#" in text:
            text = COMMENT.sub(rb"\1", text).replace(b" \n", b"\n").rstrip(b" ")
        self.lines = text.split(b"\n")
        self.kinds = np.array([line[:2] for line in self.lines], "S2") if self.lines else np.zeros(0, "S2")

    def numbers(self, kind: bytes) -> np.ndarray:
        """The numbers of the lines of one kind, (rows, columns) float64; rows of several lengths are cut to the shortest."""
        rows = [self.lines[k][len(kind) + 1 :] for k in self.places(kind)]
        if not rows:
            return np.zeros((0, 0))
        widths = {row.count(b" ") for row in rows}
        if len(widths) > 1:
            least = min(widths) + 1
            rows = [b" ".join(row.split(b" ", least)[:least]) for row in rows]
        columns = min(widths) + 1
        return _numbers(b" ".join(rows), len(rows) * columns).reshape(-1, columns)

    def places(self, kind: bytes) -> np.ndarray:
        """The numbers of the lines of one kind: v, vt, vn or f."""
        return np.flatnonzero(self.kinds == (kind + b" ")[:2])


def read_obj(content: bytes, beside: FilesBeside) -> FileMeshes:
    """The meshes of a file, one for each material. Raises ValueError for what is no OBJ, UserError as FilesBeside."""
    statements = _Statements(content)
    positions = statements.numbers(b"v")
    places = statements.places(b"f")
    if not len(positions) or not len(places):
        return FileMeshes([], beside.left_out)
    if positions.shape[1] < 3:
        raise ValueError("has vertices of fewer than three numbers")
    if positions.shape[1] < 6 and any(statements.lines[k].count(b" ") >= 6 for k in statements.places(b"v")):
        beside.leave_out("its vertex colours are left out: some vertices have none")
    counts = np.array([statements.lines[k].count(b" ") for k in places])
    uvs, normals = statements.numbers(b"vt")[:, :2], statements.numbers(b"vn")[:, :3]
    corners = _corners(statements, places, counts, (len(positions), len(uvs), len(normals)), beside)
    uvs = np.column_stack([uvs, np.zeros(len(uvs))]) if uvs.shape[1] == 1 else uvs
    if corners.uv is not None and not np.isfinite(uvs).all():
        beside.leave_out("its texture coordinates are left out: some are nan or inf")
        corners = corners._replace(uv=None)
    triangles, crossed = triangulated(positions[:, :3], corners.vertex, counts)
    _note_left_out(statements, counts, crossed, beside)

    owner = np.searchsorted(np.cumsum(counts), triangles[:, 0], side="right")  # the face of each triangle
    names, of_face = _materials_of_faces(statements, places)
    library = _library(statements, beside) if names != [None] else {}
    if len(names) > MAX_MESHES:
        raise ValueError(f"has {len(names)} materials, more than {MAX_MESHES}; join some")
    colours = _colours(positions)
    order = np.argsort(of_face[owner], kind="stable")
    ends = np.searchsorted(of_face[owner][order], np.arange(len(names) + 1))
    meshes = []
    for number, name in enumerate(names):
        chosen = triangles[order[ends[number] : ends[number + 1]]]
        if len(chosen):
            vertices, numbered = indexed(_of_all(corners, chosen), chosen, positions[:, :3], uvs, normals, colours)
            meshes.append(SourceMesh(vertices, numbered, np.eye(4), _material(name, library, beside)))
    return FileMeshes(meshes, beside.left_out)


def _corners(
    statements: _Statements, places: np.ndarray, counts: np.ndarray, sizes: tuple[int, int, int], beside: FilesBeside
) -> Corners:
    """What each corner of the faces names, as numbers from 0; -1 where a corner has no texture coordinates or normal.

    A negative number counts back from the face's own line. sizes: how many positions, texture coordinates and normals there are.
    """
    text = b"".join(statements.lines[k][1:] for k in places)
    named = _index_columns(text, int(counts.sum()))
    found: list[np.ndarray | None] = []
    for kind, numbers, size in zip((b"v", b"vt", b"vn"), named.T, sizes, strict=True):
        absent = numbers == 0
        if numbers.min(initial=0) < 0:
            before = np.cumsum(statements.kinds == (kind + b" ")[:2])[places]
            numbers = np.where(numbers < 0, numbers + np.repeat(before, counts) + 1, numbers)
        outside = ~absent & ((numbers < 1) | (numbers > size))
        if kind == b"v" and (absent | outside).any():
            raise ValueError("has faces with vertices that it does not have")
        if outside.any():
            what = "texture coordinates" if kind == b"vt" else "normals"
            beside.leave_out(f"its {what} are left out: some faces name others than it has")
        found.append(None if outside.any() or absent.all() else np.where(absent, -1, numbers - 1))
    assert found[0] is not None
    return Corners(found[0], found[1], found[2])


def _index_columns(text: bytes, corners: int) -> np.ndarray:
    """The three numbers of each corner (corners, 3) int64, 0 for one that is left out. Raises ValueError for words that are no corners."""
    found = np.zeros((corners, 3), np.int64)
    for columns, pattern in UNIFORM.items():
        if pattern.fullmatch(text):
            numbers = _numbers(text.replace(b"/", b" "), corners * sum(columns), np.int64)
            found[:, np.flatnonzero(columns)] = numbers.reshape(corners, -1)
            return found
    for k, word in enumerate(text.split()):
        numbers = word.split(b"/")
        if len(numbers) > 3 or not all(re.fullmatch(rb"(?:%b)?" % INDEX, number) for number in numbers) or not numbers[0]:
            raise ValueError(f"has a face with the corner {word[:40].decode('ascii', 'replace')}")
        found[k, : len(numbers)] = [int(number or 0) for number in numbers]
    return found


def _of_all(corners: Corners, triangles: np.ndarray) -> Corners:
    """Without what some corners of triangles lack."""
    uv, normal = (None if numbers is None or (numbers[triangles] < 0).any() else numbers for numbers in corners[1:])
    return Corners(corners.vertex, uv, normal)


def _note_left_out(statements: _Statements, counts: np.ndarray, crossed: int, beside: FilesBeside) -> None:
    if crossed:
        beside.leave_out(f"{crossed} of its faces cross their own edges and may be drawn too large")
    if few := int((counts < 3).sum()):
        beside.leave_out(f"{few} of its faces have fewer than three corners and are left out")
    for kind, what in NOT_DRAWN.items():
        if (statements.kinds == kind.rstrip()).any() or (statements.kinds == kind).any():
            beside.leave_out(f"its {what} are left out; faces are drawn")


def _materials_of_faces(statements: _Statements, places: np.ndarray) -> tuple[list[str | None], np.ndarray]:
    """The names of the materials in order of their first use, None for none; and of each face which of them it has."""
    lines = [k for k in np.flatnonzero(statements.kinds == b"us").tolist() if statements.lines[k].startswith(b"usemtl")]
    names = [None, *(statements.lines[k][6:].strip().decode("utf-8", "replace") for k in lines)]
    of_face = np.searchsorted(np.array(lines, np.int64), places)
    used = dict.fromkeys(names[k] for k in np.unique(of_face).tolist())
    number = {name: k for k, name in enumerate(used)}
    return list(used), np.array([number.get(name, 0) for name in names])[of_face]


def _library(statements: _Statements, beside: FilesBeside) -> dict[str, MtlMaterial]:
    """The materials of all libraries that a file names."""
    found: dict[str, MtlMaterial] = {}
    for k in np.flatnonzero(statements.kinds == b"mt").tolist():
        line = statements.lines[k]
        if line.startswith(b"mtllib"):
            rest = line[6:].strip().decode("utf-8", "replace")
            words = rest.split(" ")
            several = len(words) > 1 and not beside.exists(rest) and any(beside.exists(word) for word in words)
            for name in words if several else [rest.strip('"')]:
                content = beside.read_library(name)
                found |= read_mtl(content, beside) if content is not None else {}
    return found


def _material(name: str | None, library: dict[str, MtlMaterial], beside: FilesBeside) -> Phong | None:
    if name is None:
        return None
    if name not in library:
        if library:
            beside.leave_out(f"material {name[:MAX_SHOWN]} is left out: no library has it")
        return None
    return phong_from_mtl(name, library[name], beside)


def _colours(positions: np.ndarray) -> np.ndarray | None:
    """Colours (n, 4) float32 behind the positions' three coordinates, sRGB-coded in 0 .. 1 or 0 .. 255; None where there are none."""
    if positions.shape[1] not in (6, 7) or not np.isfinite(positions[:, 3:6]).all():
        return None
    coded = positions[:, 3:6] / (255.0 if positions[:, 3:6].max() > 1 else 1.0)
    colours = np.ones((len(coded), 4), np.float32)
    colours[:, :3] = linear_from_srgb(np.clip(coded, 0, 1))
    return colours


def _numbers(text: bytes, count: int, dtype: type = np.float64) -> np.ndarray:
    """`count` numbers (count,). Raises ValueError where there are more or fewer, or words."""
    with warnings.catch_warnings():  # numpy stops at a word, with a warning
        warnings.simplefilter("ignore")
        found = np.fromstring(text, dtype, sep=" ") if text.strip() else np.zeros(0, dtype)
    if len(found) != count:
        words = text.split()
        np.array(words, np.float64)  # which names a word that is no number
        raise ValueError(f"has {len(words)} numbers where {count} must be")
    return found
