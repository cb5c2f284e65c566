"""PLY files, text and binary (Turk 1994, "The PLY Polygon File Format"): faces of any number of corners, mixed, and triangle strips.

Library readers such as trimesh's read binary faces of one kind only.
"""

import re
from collections.abc import Sized
from typing import NamedTuple

import numpy as np

from vemlight.light.colour import linear_from_srgb
from vemlight.renderer.scene.files_beside import FilesBeside
from vemlight.renderer.scene.materials import Material, Phong
from vemlight.renderer.scene.polygons import RESTART, strip_triangles, triangulated
from vemlight.renderer.scene.source_mesh import Corners, FileMeshes, SourceMesh, indexed
from vemlight.renderer.scene.textures import Texture

MAX_HEADER_BYTES = 2**16
MAX_PROPERTIES = 256  # of a file; scans have some dozens
MAX_ROWS = 2**31
DTYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8", "int8": "i1",
    "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8", "int64": "i8",
    "uint64": "u8",
}  # fmt: skip
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}
UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("texture_s", "texture_t"))
CORNER_LISTS = ("vertex_indices", "vertex_index")
COLOUR_NAMES = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))
READ_COLUMNS = frozenset({*CORNER_LISTS, "texcoord", "texnumber", *(name for names in (*COLOUR_NAMES, *UV_NAMES) for name in names)})
READ_COLUMNS |= {"x", "y", "z", "nx", "ny", "nz"}


class PlyProperty(NamedTuple):
    """A column of an element. count_dtype: of a list's length; None for a single number."""

    name: str
    dtype: str
    count_dtype: str | None


class PlyElement(NamedTuple):
    """A table of a file."""

    name: str
    rows: int
    properties: list[PlyProperty]


class PlyList(NamedTuple):
    """A column of lists, one after the other. values: (sum of counts,). counts: (rows,) int64."""

    values: np.ndarray
    counts: np.ndarray


Columns = dict[str, np.ndarray | PlyList]


def read_ply(content: bytes, beside: FilesBeside) -> FileMeshes:
    """The faces and strips of a file, one mesh for each of its images. Raises ValueError for what is no PLY, UserError as FilesBeside."""
    order, elements, images, begin = _header(content)
    tables = _text_tables(content[begin:], elements) if not order else _binary_tables(content, begin, order, elements)
    vertices, faces = tables.get("vertex", {}), tables.get("face", {})
    if not {"x", "y", "z"} <= vertices.keys():
        return FileMeshes([], beside.left_out)
    positions = _rows(vertices, ("x", "y", "z"))
    corner_list = next((faces[name] for name in CORNER_LISTS if name in faces), PlyList(np.zeros(0), np.zeros(0, np.int64)))
    if not isinstance(corner_list, PlyList):
        raise ValueError("has faces that are no lists of corners")
    vertex, counts = corner_list.values.astype(np.int64), corner_list.counts
    if len(vertex) and not 0 <= vertex.min() <= vertex.max() < len(positions):
        raise ValueError("has faces with vertices that it does not have")
    triangles, crossed = triangulated(positions, vertex, counts)
    if crossed:
        beside.leave_out(f"{crossed} of its faces cross their own edges and may be drawn too large")
    if few := int((counts < 3).sum()):
        beside.leave_out(f"{few} of its faces have fewer than three corners and are left out")
    owner = np.searchsorted(np.cumsum(counts), triangles[:, 0], side="right")

    corners, uvs = _corner_uvs(vertices, faces, vertex, counts, beside)
    colours = _colours(vertices)
    of_faces = _colours(faces)
    if of_faces is not None:  # a face's colour is that of its corners, which then are no other face's
        corners = corners._replace(normal=None)
        positions, colours, vertex = positions[vertex], np.repeat(of_faces, counts, axis=0), np.arange(len(vertex))
    corners = corners._replace(vertex=vertex)
    normals = _rows(vertices, ("nx", "ny", "nz")) if {"nx", "ny", "nz"} <= vertices.keys() and of_faces is None else np.zeros((0, 3))
    if len(normals):
        corners = corners._replace(normal=vertex)

    image_of_face = _image_numbers(faces, len(counts), len(images))
    meshes = []
    for number in np.unique(image_of_face[owner]).tolist():
        chosen = triangles[image_of_face[owner] == number]
        found, numbered = indexed(corners, chosen, positions, uvs, normals, colours)
        material = _material(images, number, corners.uv is not None, beside)
        meshes.append(SourceMesh(found, numbered, np.eye(4), material))
    strips = _strip_triangles(tables.get("tristrips", {}), len(_rows(vertices, ("x",))))
    if len(strips):
        whole = Corners(np.arange(len(_rows(vertices, ("x",)))))
        found, numbered = indexed(whole, strips, _rows(vertices, ("x", "y", "z")), uvs, normals, _colours(vertices))
        meshes.append(SourceMesh(found, numbered, np.eye(4), None))
    return FileMeshes(meshes, beside.left_out)


def _header(content: bytes) -> tuple[str, list[PlyElement], list[str], int]:
    """The byte order ("" for text), the elements, the images named, and where the header ends."""
    end = re.search(rb"^end_header[ \t]*(?:\r\n|\n|\r)", content[:MAX_HEADER_BYTES], re.MULTILINE) or re.search(
        rb"(?<=\r)end_header[ \t]*\r", content[:MAX_HEADER_BYTES]
    )
    if not content.startswith(b"ply") or end is None:
        raise ValueError("has no header of a PLY")
    order, elements, images, properties = None, [], [], 0
    for line in re.split(r"[\r\n]+", content[: end.start()].decode("latin-1")):
        match line.split():
            case ["format", name, *_]:
                order = ORDERS.get(name)
            case ["element", name, rows]:
                elements.append(PlyElement(name, int(rows), []))
                if not 0 <= elements[-1].rows <= MAX_ROWS:
                    raise ValueError(f"has {rows} rows of {name[:40]}")
            case ["property", "list", count, item, name] if elements:
                elements[-1].properties.append(PlyProperty(name, DTYPES[item], DTYPES[count]))
                properties += 1
            case ["property", item, name] if elements:
                elements[-1].properties.append(PlyProperty(name, DTYPES[item], None))
                properties += 1
            case ["comment", "TextureFile", *words]:
                images.append(" ".join(words))
    if order is None or properties > MAX_PROPERTIES or len(elements) > MAX_PROPERTIES:
        raise ValueError(f"has no format that is read, or more than {MAX_PROPERTIES} elements or properties")
    return order, elements, images, end.end()


def _binary_tables(content: bytes, begin: int, order: str, elements: list[PlyElement]) -> dict[str, Columns]:
    tables: dict[str, Columns] = {}
    for element in elements:
        if element.properties:
            found = _alike_rows(content, begin, order, element)
            tables[element.name], begin = found or _unlike_rows(content, begin, order, element)
    return tables


def _alike_rows(content: bytes, begin: int, order: str, element: PlyElement) -> tuple[Columns, int] | None:
    """The columns of an element and where it ends; None where its lists are not all as long as those of its first row."""
    at, fields, lengths = begin, [], {}
    for k, column in enumerate(element.properties):
        dtype, count = np.dtype(order + column.dtype), 1
        if column.count_dtype:
            count_dtype = np.dtype(order + column.count_dtype)
            _check_length(content, at + (count_dtype.itemsize if element.rows else 0))
            count = lengths[f"n{k}"] = int(np.frombuffer(content, count_dtype, 1, at)[0]) if element.rows else 0
            fields.append((f"n{k}", count_dtype, ()))
            at += count_dtype.itemsize
        if not 0 <= count <= len(content):
            return None
        fields.append((f"{k}", dtype, (count,) if column.count_dtype else ()))
        at += dtype.itemsize * count
    if at - begin > len(content):
        return None
    row = np.dtype(fields)
    end = begin + element.rows * row.itemsize
    if end > len(content):
        if not lengths:
            _check_length(content, end)
        return None
    table = np.frombuffer(content, row, element.rows, begin)
    if any((table[name] != length).any() for name, length in lengths.items()):
        return None
    columns: Columns = {}
    for k, column in enumerate(element.properties):
        values = table[f"{k}"]
        columns[column.name] = PlyList(values.reshape(-1), np.full(len(values), lengths[f"n{k}"])) if column.count_dtype else values
    return columns, end


def _unlike_rows(content: bytes, begin: int, order: str, element: PlyElement) -> tuple[Columns, int]:
    """As `_alike_rows`, of lists of any lengths."""
    from vemlight.renderer.scene.ply_rows import gather, row_offsets  # here, since it loads numba

    data = np.frombuffer(content, np.uint8)
    is_list = np.array([column.count_dtype is not None for column in element.properties])
    if any(column.count_dtype in ("f4", "f8") for column in element.properties):
        raise ValueError("has lists whose lengths are no whole numbers")
    count_sizes = np.array([np.dtype(column.count_dtype).itemsize if column.count_dtype else 0 for column in element.properties])
    sizes = np.array([np.dtype(column.dtype).itemsize for column in element.properties])
    _check_length(content, begin + element.rows * int(np.where(is_list, count_sizes, sizes).sum()))
    read = np.array([column.name in READ_COLUMNS for column in element.properties])
    offsets = np.zeros((int(read.sum()), element.rows), np.int64)
    counts = np.ones_like(offsets)
    end = row_offsets(data, begin, is_list, count_sizes, sizes, order == ">", read, offsets, counts)
    if end < 0:
        raise ValueError(f"ends within its rows of {element.name[:40]}: it was cut off")
    columns: Columns = {}
    for k, column in enumerate(column for column in element.properties if column.name in READ_COLUMNS):
        dtype = np.dtype(order + column.dtype)
        values = np.empty(int(counts[k].sum()), dtype)
        gather(data, offsets[k], counts[k], dtype.itemsize, values.view(np.uint8))
        columns[column.name] = PlyList(values, counts[k]) if column.count_dtype else values
    return columns, end


def _text_tables(content: bytes, elements: list[PlyElement]) -> dict[str, Columns]:
    words = content.split()
    numbers = np.array(words, np.float64) if words else np.zeros(0)
    tables: dict[str, Columns] = {}
    begin = 0
    for element in elements:
        _check_length(numbers, begin + element.rows * len(element.properties))
        is_list = [column.count_dtype is not None for column in element.properties]
        if any(is_list):
            offsets = np.zeros((len(is_list), element.rows), np.int64)
            counts = np.ones_like(offsets)
            begin = _text_offsets(numbers, begin, is_list, offsets, counts)
        else:
            offsets = begin + np.arange(element.rows * len(is_list)).reshape(element.rows, len(is_list)).T
            counts = np.ones_like(offsets)
            begin += offsets.size
        columns = tables[element.name] = {}
        for k, column in enumerate(element.properties):
            places = np.repeat(offsets[k] - (np.cumsum(counts[k]) - counts[k]), counts[k])
            values = numbers[places + np.arange(len(places))]
            columns[column.name] = PlyList(values, counts[k]) if column.count_dtype else values.astype(column.dtype)
    return tables


def _text_offsets(numbers: np.ndarray, at: int, is_list: list[bool], offsets: np.ndarray, counts: np.ndarray) -> int:
    """Fills the place and the count of each column's values in each row (columns, rows), and returns where they end."""
    for row in range(offsets.shape[1]):
        for k, listed in enumerate(is_list):
            count = 1
            if listed:
                count = int(numbers[at]) if at < len(numbers) and np.isfinite(numbers[at]) else -1
                at += 1
            if count < 0 or at + count > len(numbers):
                raise ValueError("ends within its rows: it was cut off")
            offsets[k, row], counts[k, row] = at, count
            at += count
    return at


def _check_length(content: Sized, needed: int) -> None:
    if needed > len(content):
        raise ValueError(f"has fewer rows than its header promises ({len(content)} of {needed}): it was cut off")


def _rows(table: Columns, names: tuple[str, ...]) -> np.ndarray:
    """Columns of single numbers side by side, float64."""
    columns = [table[name] for name in names]
    if any(isinstance(column, PlyList) for column in columns):
        raise ValueError(f"has lists where {', '.join(names)} must be numbers")
    return np.column_stack([np.asarray(column, np.float64) for column in columns])


def _corner_uvs(
    vertices: Columns, faces: Columns, vertex: np.ndarray, counts: np.ndarray, beside: FilesBeside
) -> tuple[Corners, np.ndarray]:
    """The corners with their texture coordinates: those of the faces, else those of the vertices."""
    wedges = faces.get("texcoord")
    names = next((pair for pair in UV_NAMES if set(pair) <= vertices.keys()), None)
    if isinstance(wedges, PlyList) and np.array_equal(wedges.counts, 2 * counts):
        uvs, numbers = np.asarray(wedges.values, np.float64).reshape(-1, 2), np.arange(len(vertex))
    elif names:
        uvs, numbers = _rows(vertices, names), vertex
    else:
        return Corners(vertex), np.zeros((0, 2))
    if not np.isfinite(uvs).all():
        beside.leave_out("its texture coordinates are left out: some are nan or inf")
        return Corners(vertex), np.zeros((0, 2))
    return Corners(vertex, numbers), uvs


def _colours(table: Columns) -> np.ndarray | None:
    """Colours (n, 4) float32 of a table's rows, linear with alpha 1; None where it has none that are finite."""
    for names in COLOUR_NAMES:
        if set(names) <= table.keys():
            columns = [np.asarray(table[name]) for name in names]
            coded = np.column_stack([column / (np.iinfo(column.dtype).max if column.dtype.kind in "iu" else 1.0) for column in columns])
            if np.isfinite(coded).all() and len(coded):
                if columns[0].dtype.kind == "f" and coded.max() > 1:
                    coded = coded / 255.0
                colours = np.ones((len(coded), 4), np.float32)
                colours[:, :3] = linear_from_srgb(np.clip(coded, 0, 1))
                return colours
    return None


def _image_numbers(faces: Columns, count: int, images: int) -> np.ndarray:
    """Which image each face has, (count,) int64."""
    numbers = faces.get("texnumber")
    if images < 2 or not isinstance(numbers, np.ndarray) or len(numbers) != count:
        return np.zeros(count, np.int64)
    return np.clip(np.nan_to_num(numbers.astype(np.float64)), 0, images - 1).astype(np.int64)


def _material(images: list[str], number: int, has_uvs: bool, beside: FilesBeside) -> Material | None:
    if not images:
        return None
    if not has_uvs:
        beside.leave_out(f"{images[number][:60]} is left out: the faces have no texture coordinates")
        return None
    texels = beside.texels(images[number])
    return None if texels is None else Phong((1.0, 1.0, 1.0), colour_map=Texture(texels))


def _strip_triangles(strips: Columns, vertices: int) -> np.ndarray:
    """Triangles (m, 3) of vertices, of strips with RESTART between them."""
    corners = next((strips[name] for name in CORNER_LISTS if name in strips), None)
    if not isinstance(corners, PlyList):
        return np.zeros((0, 3), np.int64)
    numbers = corners.values.astype(np.int64)
    # the end of a row ends a strip, too
    numbers = np.insert(numbers, np.cumsum(corners.counts), RESTART)
    triangles = strip_triangles(numbers)
    if len(triangles) and triangles.max() >= vertices:
        raise ValueError("has strips with vertices that it does not have")
    return triangles
