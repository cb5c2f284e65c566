"""A scene's triangles in Embree, Intel's library of ray kernels, which the package embreex brings along.

Only what shadow rays and bounces need is declared here, by ctypes: embreex' own Python layer traces a sixth of the rays in the same time.
"""

import ctypes
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from vemlight.errors import FatalError, UserError
from vemlight.renderer.scene.scene import Scene

# Embree's header rtcore_common.h, version 4.
TRIANGLES, INDEX_BUFFER, VERTEX_BUFFER, UINT3, FLOAT3 = 0, 0, 1, 0x5003, 0x9003
ROBUST = 4  # scene flag: without it rays pass between the triangles of a closed box at their common edges
OUT_OF_MEMORY = 4
LIBRARIES = ("libembree4*.so*", "libembree4*.dylib", "embree4*.dll")

POINTER, INT, UINT, SIZE = ctypes.c_void_p, ctypes.c_int, ctypes.c_uint, ctypes.c_size_t
# Of each function: its result and its arguments.
FUNCTIONS = {
    "rtcNewDevice": (POINTER, [ctypes.c_char_p]),
    "rtcReleaseDevice": (None, [POINTER]),
    "rtcGetDeviceError": (INT, [POINTER]),
    "rtcNewScene": (POINTER, [POINTER]),
    "rtcReleaseScene": (None, [POINTER]),
    "rtcSetSceneFlags": (None, [POINTER, INT]),
    "rtcCommitScene": (None, [POINTER]),
    "rtcNewGeometry": (POINTER, [POINTER, INT]),
    "rtcReleaseGeometry": (None, [POINTER]),
    "rtcSetNewGeometryBuffer": (POINTER, [POINTER, INT, UINT, INT, SIZE, SIZE]),
    "rtcUpdateGeometryBuffer": (None, [POINTER, INT, UINT]),
    "rtcSetGeometryUserData": (None, [POINTER, POINTER]),
    "rtcSetGeometryOccludedFilterFunction": (None, [POINTER, POINTER]),
    "rtcSetGeometryIntersectFilterFunction": (None, [POINTER, POINTER]),
    "rtcCommitGeometry": (None, [POINTER]),
    "rtcAttachGeometry": (UINT, [POINTER, POINTER]),
    "rtcOccluded16": (None, [POINTER, POINTER, POINTER, POINTER]),
    "rtcIntersect16": (None, [POINTER, POINTER, POINTER, POINTER]),
}


@cache
def library() -> ctypes.CDLL | None:
    """Embree with its functions declared; None where embreex is not installed or its library does not load."""
    spec = find_spec("embreex")
    if spec is None or spec.origin is None:
        return None
    package = Path(spec.origin).parent
    folders = (package.with_name("embreex.libs"), package / ".dylibs", package)
    for path in (path for folder in folders for pattern in LIBRARIES for path in sorted(folder.glob(pattern))):
        try:
            found = ctypes.CDLL(str(path))
            for name, (result, arguments) in FUNCTIONS.items():
                function = getattr(found, name)
                function.restype, function.argtypes = result, arguments
        except (OSError, AttributeError):  # built for another system, or an Embree before version 4
            continue
        return found
    return None


def function_address(name: str) -> int:
    """Where a function of Embree lies in memory."""
    address = ctypes.cast(getattr(_loaded(), name), POINTER).value
    assert address
    return address


def _loaded() -> ctypes.CDLL:
    found = library()
    assert found is not None  # who asks for rays without Embree is told so (shadows.py)
    return found


class RayScene:
    """The triangles of a scene's meshes, about the scene's centre: float32 resolves the more of it the farther it is from the origin.

    address: of Embree's scene. origin: (3,) float64, the world's place that is 0 there.
    """

    def __init__(self, scene: Scene, filters: "dict[int, tuple[int, int]] | None" = None) -> None:
        """filters: of each mesh with holes, by its number: the addresses of its filter function and of that function's data."""
        self._embree = _loaded()
        self.origin = scene.centre.astype(np.float64)
        self._scene, self._device = scene, self._embree.rtcNewDevice(None)
        self.address: int = self._embree.rtcNewScene(self._device)
        self._embree.rtcSetSceneFlags(self.address, ROBUST)
        self._matrices = np.full((len(scene.meshes), 4, 4), np.nan)
        self._geometries: list[int] = []
        self._vertices: list[np.ndarray] = []
        for number, mesh in enumerate(scene.meshes):
            geometry = self._embree.rtcNewGeometry(self._device, TRIANGLES)
            triangles, vertices = mesh.geometry.triangles, mesh.geometry.positions
            self._buffer(geometry, INDEX_BUFFER, UINT3, np.uint32, len(triangles))[:] = triangles
            self._vertices.append(self._buffer(geometry, VERTEX_BUFFER, FLOAT3, np.float32, len(vertices)))
            if filters and number in filters:
                function, data = filters[number]
                self._embree.rtcSetGeometryOccludedFilterFunction(geometry, function)
                self._embree.rtcSetGeometryIntersectFilterFunction(geometry, function)
                self._embree.rtcSetGeometryUserData(geometry, data)
            self._geometries.append(geometry)
        self.place(np.tile(np.eye(4), (len(scene.meshes), 1, 1)))
        for geometry in self._geometries:
            self._embree.rtcAttachGeometry(self.address, geometry)
            self._embree.rtcReleaseGeometry(geometry)  # the scene keeps it
        self._embree.rtcCommitScene(self.address)
        self._check()

    def _buffer(self, geometry: int, kind: int, form: int, dtype: type[np.generic], count: int) -> np.ndarray:
        """A new buffer (count, 3) of a geometry, in Embree's memory."""
        place = self._embree.rtcSetNewGeometryBuffer(geometry, kind, 0, form, 12, count)
        if not place:
            self._check()
        numbers = (ctypes.c_uint32 if dtype is np.uint32 else ctypes.c_float) * (3 * count)
        memory: Any = numbers.from_address(place)
        return np.frombuffer(memory, dtype).reshape(count, 3)

    def place(self, matrices: np.ndarray) -> None:
        """Moves the meshes: world_from_rest (n, 4, 4) float64."""
        moved = [k for k in range(len(matrices)) if not np.array_equal(matrices[k], self._matrices[k])]
        for k in moved:
            rest = self._scene.meshes[k].geometry.positions.astype(np.float64)
            self._vertices[k][:] = rest @ matrices[k, :3, :3].T + (matrices[k, :3, 3] - self.origin)
            self._embree.rtcUpdateGeometryBuffer(self._geometries[k], VERTEX_BUFFER, 0)
            self._embree.rtcCommitGeometry(self._geometries[k])
        self._matrices = matrices.copy()
        if moved:
            self._embree.rtcCommitScene(self.address)
            self._check()

    def _check(self) -> None:
        """Raises UserError when Embree has no memory, FatalError for what it does not say."""
        error = self._embree.rtcGetDeviceError(self._device)
        if error == OUT_OF_MEMORY:
            raise UserError('[renderer] scene: there is no memory to trace it; make its meshes smaller, or choose shadows = "maps"')
        if error:
            raise FatalError(f"Embree stopped working (error {error}); start again")

    def release(self) -> None:
        """Frees what Embree holds."""
        self._vertices.clear()
        self._embree.rtcReleaseScene(self.address)
        self._embree.rtcReleaseDevice(self._device)
