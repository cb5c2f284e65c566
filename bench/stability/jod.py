"""ColorVideoVDP in a process of its own: torch and the software renderer each bring an LLVM, and one process with both crashes."""

import math
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from importlib.util import find_spec
from multiprocessing import get_context

import numpy as np

DISPLAY_NITS = 200.0  # the mean of a clip is shown at a fifth of it


def jod(clip: np.ndarray, truth: np.ndarray, fps: float) -> float:
    """The quality of a clip (frames, rows, cols, 3) whose mean is 1 on a standard display, in JOD; nan without the package cvvdp."""
    return _judge().submit(_jod, clip, truth, fps).result() if find_spec("pycvvdp") else math.nan


@lru_cache(maxsize=1)
def _judge() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"))


def _jod(clip: np.ndarray, truth: np.ndarray, fps: float) -> float:
    import pycvvdp  # pyright: ignore[reportMissingImports]
    import torch  # pyright: ignore[reportMissingImports]

    metric = pycvvdp.cvvdp(display_name="standard_hdr_linear", device=torch.device("cpu"), heatmap=None)
    shown = [np.clip(each * DISPLAY_NITS / 5, 0.05, 1500).astype(np.float32) for each in (clip, truth)]
    quality, _ = metric.predict(*shown, dim_order="FHWC", frames_per_second=fps)
    return float(quality)
