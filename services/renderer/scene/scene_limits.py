"""How much the files of one scene may become in memory: a downloaded file of a few kilobytes must not ask for gigabytes or minutes.

Small files may be instanced and repeated up to fixed counts, large ones as far as their own bytes go.
"""

MAX_MESHES = 4096  # drawn one by one: each takes about 1 ms to prepare, and a draw call
MAX_VIEWS = 32  # that a page offers; as many as fit a menu
MAX_LUMINAIRES = 256  # each has maps of its own
FREE_CORNERS = 2**20  # of triangles: 350,000 of them take 1.5 s and 270 MB to clean
FREE_VERTICES = 2**22  # of meshes in place: with position, normal and texture coordinates 130 MB


class SceneLimits:
    """Counts what the files of a scene become. Each method raises ValueError, whose text continues "FILE ...", beyond a limit."""

    def __init__(self) -> None:
        self._stored_bytes = self._corners = self._vertices = self._meshes = 0

    def on_stored(self, size: int) -> None:
        """Of each file once: a triangle takes at least 12 bytes in any of them, so that only what is repeated comes to a limit."""
        self._stored_bytes += size

    def on_cleaned(self, triangles: int) -> None:
        """Before triangles are cleaned."""
        self._corners += 3 * triangles
        if self._corners > max(FREE_CORNERS, self._stored_bytes):
            raise ValueError(f"draws {self._corners // 3} triangles from {self._stored_bytes} bytes; repeat fewer of them")

    def on_placed(self, vertices: int) -> None:
        """Before a mesh is put in its place in the file or in the world."""
        self._meshes += 1
        self._vertices += vertices
        if self._meshes > MAX_MESHES:
            raise ValueError(f"draws more than {MAX_MESHES} meshes; join them")
        if self._vertices > max(FREE_VERTICES, self._stored_bytes):
            raise ValueError(f"draws {self._vertices} vertices from {self._stored_bytes} bytes; repeat fewer of them")
