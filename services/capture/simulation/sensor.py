"""What the virtual camera's sensor makes of light, and its frames on disk."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from vemlight.capture.frames import Mosaic
from vemlight.capture.lens import Lens, pixel_angles, vignetting_from_angle, write_lens
from vemlight.capture.response import Response, code_from_signal, write_response
from vemlight.capture.sequence import MANIFEST, file_entry
from vemlight.light.images import write_exr

HALF_TOP = 65504.0  # the largest half float


def behind_lens(radiance: np.ndarray, lens: Lens) -> np.ndarray:
    """The radiance (height, width, 3) that the sensor sees, vignetting included."""
    return radiance * vignetting_from_angle(np.minimum(pixel_angles(lens), lens.rim), lens)[..., None]


def fixed_pattern(lens: Lens, sigma_codes: float, seed: int) -> np.ndarray:
    """Each pixel's own offset in codes, the same in all frames, (height, width, 1) float64."""
    return np.random.default_rng((seed, 2 << 32)).normal(0.0, sigma_codes, (lens.size[1], lens.size[0], 1))


def exposed(
    radiance: np.ndarray,
    response: Response | None,
    noise_codes: float,
    pattern: np.ndarray,
    mosaic: Mosaic | None,
    seed: tuple[int, int],
) -> np.ndarray:
    """A file's pixels of the `radiance` (height, width, 3) behind the lens.

    Codes as float32 after noise of `noise_codes` (sigma) and the fixed `pattern`, (height, width) of a mosaic or (height, width, 3);
    without a response the radiance as half floats.
    """
    if response is None:
        return np.minimum(radiance, HALF_TOP).astype(np.float16)
    if mosaic:
        radiance = through_mosaic(radiance, mosaic)[..., None]
    signal = response.signal(radiance) + pattern
    if noise_codes > 0:
        signal += np.random.default_rng(seed).normal(0.0, noise_codes, signal.shape)
    codes = code_from_signal(signal, response).astype(np.float32)
    return codes[..., 0] if mosaic else codes


def through_mosaic(rgb: np.ndarray, mosaic: Mosaic) -> np.ndarray:
    """What a sensor with colour filters before its pixels sees of (height, width, 3), (height, width); a gray one sees the mean."""
    if mosaic == "mono":
        return rgb.mean(axis=-1)
    seen = np.empty(rgb.shape[:2], rgb.dtype)
    for n, colour in enumerate(mosaic):
        seen[n // 2 :: 2, n % 2 :: 2] = rgb[n // 2 :: 2, n % 2 :: 2, "RGB".index(colour)]
    return seen


class Film:
    """A folder of frames with lens.toml, response.toml and manifest.jsonl beside them."""

    def __init__(
        self, folder: Path, name: str, lens: Lens, response: Response | None, mosaic: Mosaic | None, fps: float, exposure_s: float
    ):
        """Makes the folder and writes all but the frames; a manifest that is there is begun anew."""
        self._folder, self._name = folder, name
        folder.mkdir(parents=True, exist_ok=True)
        write_lens(folder / "lens.toml", lens)
        self._attributes: dict[str, Any] = {
            "framesPerSecond": Fraction(fps).limit_denominator(1001),
            "vemlight:kind": "fisheye" if response is None else "codes",
        }
        if exposure_s > 0:
            self._attributes["expTime"] = exposure_s
        if response is not None:
            write_response(folder / "response.toml", response)
            self._attributes["colorInteropID"] = "data"  # codes are no colours
        if mosaic is not None:
            self._attributes["vemlight:mosaic"] = mosaic
        (folder / MANIFEST).write_bytes(b"")

    def name(self, k: int) -> str:
        """File name of frame `k`."""
        return f"{self._name}_{k:04d}.exr"

    def write(self, k: int, time_s: float, pixels: np.ndarray) -> None:
        """Writes frame `k` and its line of the manifest."""
        path = self._folder / self.name(k)
        write_exr(path, pixels, {**self._attributes, "imageCounter": k, "vemlight:time_s": repr(time_s)})
        with open(self._folder / MANIFEST, "ab") as manifest:
            manifest.write(msgspec.json.encode(file_entry(path, k, time_s)) + b"\n")
