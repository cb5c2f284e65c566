"""What trimesh may read for an OBJ, PLY or STL file: its content checked for what would take much memory, and the files beside it.

trimesh passes over every fault of a material library or an image; here they are found first.
"""

import codecs
import os
import re
from pathlib import Path

from vemlight.errors import UserError
from vemlight.files import MAX_SHOWN, contained_path, one_line, read_file
from vemlight.light.image_limits import MAX_IMAGE_BYTES
from vemlight.renderer.scene.scene_limits import FREE_COPIES
from vemlight.renderer.scene.textures import FREE_TEXTURE_BYTES, HALF_BYTES, MAX_TEXTURE_SIDE, TEXTURE_RATIO, open_picture

MAX_BYTES = 2**29  # 5 million triangles with normals and texture coordinates in text
MAX_PARTS = 2048  # materials of an OBJ, solids of an STL: each is a mesh, and trimesh takes the square of their number, 4 s
MAX_LINES = 20  # about what is left out; who reads more of them?
MAX_LIBRARY_BYTES = 2**22  # 20,000 materials


class FilesBeside:
    """trimesh's resolver: the material library as item, the images by `get`.

    refused: the first reference that must not be followed. left_out: a line for each file that is left out.
    """

    def __init__(self, folder: Path, where: str) -> None:
        self._folder, self._where = folder, where
        self._images: dict[str, bytes | None] = {}  # by name, None for one that is left out
        self._texture_bytes = 0
        self.refused: UserError | None = None
        self.left_out: list[str] = []

    def __getitem__(self, name: str) -> bytes:
        return self._content(name, MAX_LIBRARY_BYTES).removeprefix(codecs.BOM_UTF8)

    def get(self, name: str) -> bytes:
        """An image that can be decoded. Each material asks for its own anew."""
        if name not in self._images:
            self._images[name] = None
            self._images[name] = self._image(name)
        content = self._images[name]
        if content is None:
            raise OSError(name)
        return content

    def _image(self, name: str) -> bytes | None:
        content = self._content(name, MAX_IMAGE_BYTES)
        try:
            with open_picture(content, name[:MAX_SHOWN]) as image:
                width, height = image.size
            self._texture_bytes += min(width, MAX_TEXTURE_SIDE) * min(height, MAX_TEXTURE_SIDE) * 3 * HALF_BYTES
            stored_bytes = len(content) + sum(len(stored) for stored in self._images.values() if stored)
            if self._texture_bytes > max(FREE_TEXTURE_BYTES, TEXTURE_RATIO * stored_bytes):
                raise ValueError(f"with the others it takes far more memory than the {stored_bytes} bytes that they are stored in")
        except Exception as error:  # a hostile file raises whatever Pillow trips over
            self._leave_out(name, one_line(error))
            return None
        return content

    def _content(self, name: str, max_bytes: int) -> bytes:
        try:
            path = contained_path(self._folder, name, self._where)
            if not os.path.exists(path):
                self._leave_out(name, "there is no such file beside it")
                raise FileNotFoundError(name)
            return read_file(path, max_bytes)
        except UserError as error:
            self.refused = self.refused or error
            raise OSError(name) from error

    def _leave_out(self, name: str, reason: str) -> None:
        if len(self.left_out) < MAX_LINES:
            self.left_out.append(f"{name[:MAX_SHOWN]} is left out: {reason}")


def check_stl(content: bytes) -> None:
    """Raises ValueError for a text STL of too many solids."""
    if (solids := content.count(b"endsolid")) > MAX_PARTS:
        raise ValueError(f"has {solids} solids, more than {MAX_PARTS}; join them")


def check_obj(content: bytes) -> None:
    """Raises ValueError for an OBJ that would take much memory for its size: trimesh makes arrays as long as the largest number of a
    vertex that a face names, and copies all vertices for each material.
    """
    content = content.replace(b"\r\n", b"\n").replace(b"\\\n", b"")
    vertices = content.count(b"\nv") + content.startswith(b"v")  # v, vt and vn
    if re.search(rb"^f[^\n]*\d{%d}" % (len(str(vertices)) + 1), content, re.MULTILINE):
        raise ValueError("has triangles with vertices that it does not have")
    materials = content.count(b"usemtl")
    if materials > MAX_PARTS or materials * vertices > max(FREE_COPIES, len(content)):
        names = len(set(re.findall(rb"^[ \t]*usemtl[^\n]*", content, re.MULTILINE)))
        if names > MAX_PARTS or names * vertices > max(FREE_COPIES, len(content)):
            raise ValueError(f"has {names} materials on {vertices} vertices; split it or join its materials")
