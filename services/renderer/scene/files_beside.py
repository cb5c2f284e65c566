"""The files that an OBJ, .mtl or PLY file names, which lie beside it."""

import codecs
import os
from pathlib import Path, PureWindowsPath

import numpy as np

from vemlight.files import MAX_SHOWN, contained_path, one_line, read_file
from vemlight.light.image_limits import MAX_IMAGE_BYTES
from vemlight.renderer.scene.textures import (
    FREE_TEXTURE_BYTES,
    HALF_BYTES,
    MAX_TEXTURE_SIDE,
    TEXTURE_RATIO,
    open_picture,
    texels_from_image,
)

MAX_LINES = 20  # about what is left out; who reads more of them?
MAX_LIBRARY_BYTES = 2**22  # 20,000 materials


class FilesBeside:
    """Material libraries and images. left_out: a line for each thing that is left out."""

    def __init__(self, folder: Path, where: str) -> None:
        self._folder, self._where = folder, where
        self._texels: dict[str, np.ndarray | None] = {}  # by name, None for one that is left out
        self._texture_bytes = self._stored_bytes = 0
        self.left_out: list[str] = []

    def read_library(self, name: str) -> bytes | None:
        """A material library; None for one that is not there. Raises UserError for a reference out of the folder."""
        content = self._content(name, MAX_LIBRARY_BYTES)
        return None if content is None else content.removeprefix(codecs.BOM_UTF8)

    def exists(self, name: str) -> bool:
        """Whether there is such a file. Raises UserError for a reference out of the folder."""
        return os.path.exists(contained_path(self._folder, _with_slashes(name), self._where))

    def texels(self, name: str) -> np.ndarray | None:
        """An image as `texels_from_image` makes it; None for one that is left out. Raises UserError as `library`."""
        if name not in self._texels:
            content = self._content(name, MAX_IMAGE_BYTES)
            self._texels[name] = None if content is None else self._decoded(name, content)
        return self._texels[name]

    def leave_out(self, line: str) -> None:
        """Adds a line, once."""
        if len(self.left_out) < MAX_LINES and line not in self.left_out:
            self.left_out.append(line)

    def _decoded(self, name: str, content: bytes) -> np.ndarray | None:
        try:
            with open_picture(content, name[:MAX_SHOWN]) as image:
                width, height = image.size
                self._texture_bytes += min(width, MAX_TEXTURE_SIDE) * min(height, MAX_TEXTURE_SIDE) * 3 * HALF_BYTES
                self._stored_bytes += len(content)
                if self._texture_bytes > max(FREE_TEXTURE_BYTES, TEXTURE_RATIO * self._stored_bytes):
                    raise ValueError(f"with the others it takes far more memory than the {self._stored_bytes} bytes they are stored in")
                return texels_from_image(image)
        except Exception as error:  # a hostile file raises whatever Pillow trips over
            self.leave_out(f"{name[:MAX_SHOWN]} is left out: {one_line(error)}")
            return None

    def _content(self, name: str, max_bytes: int) -> bytes | None:
        path = contained_path(self._folder, _with_slashes(name), self._where)
        if not os.path.exists(path):
            other = next((p.name for p in _beside(path) if p.name.lower() == path.name.lower()), "")
            reason = f"there is {other} beside it, of another case" if other else "there is no such file beside it"
            self.leave_out(f"{name[:MAX_SHOWN]} is left out: {reason}")
            return None
        return read_file(path, max_bytes)


def _with_slashes(name: str) -> str:
    """A relative name as this machine writes it, of one that Windows may have written."""
    return name if PureWindowsPath(name).drive else name.replace("\\", "/")


def _beside(path: Path) -> list[Path]:
    try:
        return sorted(path.parent.iterdir())
    except OSError:  # a folder that is not there, or none
        return []
