"""What a USD stage of lights is made of, whichever way it is written: attributes, of which some have samples at frames."""

from typing import Any, NamedTuple, Protocol

import numpy as np


class Attribute(NamedTuple):
    """type: USD's: bool, int64, float, color3f, quatf, token, token[] or asset. value: of the type, quaternions as w, x, y, z.

    With `frames`, (n,) int, ascending, it is one a frame: (n,) or (n, k) float32, or texts of assets; without, it holds always.
    """

    type: str
    name: str
    value: Any
    frames: np.ndarray | None = None
    is_custom: bool = False
    is_uniform: bool = False

    @staticmethod
    def of_frames(kind: str, name: str, frames: np.ndarray, values: np.ndarray, is_custom: bool = False) -> "Attribute":
        """values: (n,) or (n, k), cast to float32; a single value where it never changes."""
        values = values.astype(np.float32, copy=False)
        first = values[0].tolist()
        if values[-1].tolist() == first and (values == values[0]).all():  # mostly the ends differ, which takes less to see
            return Attribute(kind, name, first, None, is_custom)
        return Attribute(kind, name, values, frames, is_custom)


class LayerHead(NamedTuple):
    """codes: (frames,) float64, the time code of each frame. rate: of them a second. notes: what readers of the file may want to know."""

    codes: np.ndarray
    rate: float
    notes: dict[str, str]


class LayerWriter(Protocol):
    """Writes a layer with one Xform, ROOT, and prims below it, some at a time. All raise OSError when the disk refuses."""

    def prims(self, kind: str, prims: dict[str, list[Attribute]]) -> None: ...

    def finish(self) -> None: ...
