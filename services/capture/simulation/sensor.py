"""The virtual camera: what its lens and sensor make of light, and its frames on disk."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from vemlight.capture.exposure_recording import EXPOSURES, exposures_text
from vemlight.capture.lens import Lens, pixel_angles, vignetting_from_angle, write_lens
from vemlight.capture.manifest import MANIFEST, ManifestWriter
from vemlight.capture.mosaic import Mosaic
from vemlight.capture.response import Response, code_from_signal, write_response
from vemlight.light.images import write_exr

MAX_HALF = 65504.0  # the largest half float
DROPOUT_STREAM, PATTERN_STREAM = 1 << 32, 2 << 32  # of random numbers, apart from those of the frames, which use their own number


class VirtualCamera(msgspec.Struct, frozen=True, kw_only=True):
    """A camera that exists in arithmetic alone."""

    lens: Lens
    response: Response | None = None  # None: frames of radiance as half floats; else raw codes
    mosaic: Mosaic | None = None  # None: three channels
    fps: float = 25.0
    exposure_s: float = 0.0
    exposures: tuple[float, ...] = ()  # s, that are taken in turn; none: all frames have that of the response
    control_delay: int = 2  # frames until an exposure that is asked for takes effect
    noise_codes: float = 0.0  # Gaussian noise of the codes (sigma)
    pattern_codes: float = 0.0  # fixed pattern noise (sigma)
    dropouts: float = 0.0  # fraction of the frames that are lost, as a busy camera loses them


def behind_lens(radiance: np.ndarray, lens: Lens) -> np.ndarray:
    """The radiance (height, width, 3) that reaches the sensor, vignetting included."""
    return radiance * vignetting_from_angle(np.minimum(pixel_angles(lens), lens.rim), lens)[..., None]


def fixed_pattern(camera: VirtualCamera, seed: int) -> np.ndarray:
    """Each pixel's own offset in codes, the same in all frames, (height, width, 1) float64."""
    width, height = camera.lens.size
    return np.random.default_rng((seed, PATTERN_STREAM)).normal(0.0, camera.pattern_codes, (height, width, 1))


def received_frames(camera: VirtualCamera, count: int, seed: int) -> list[int]:
    """Numbers of the frames of 0 .. count - 1 that are not lost."""
    return np.flatnonzero(np.random.default_rng((seed, DROPOUT_STREAM)).random(count) >= camera.dropouts).tolist()


def exposed(
    radiance: np.ndarray, camera: VirtualCamera, pattern: np.ndarray, seed: tuple[int, int], exposure_s: float | None = None
) -> np.ndarray:
    """The pixels of a file for the `radiance` (height, width, 3) behind the lens; exposure_s: where it is not the response's.

    Codes as float32 after noise and the fixed `pattern`, (height, width) of a mosaic or (height, width, 3); radiance as half floats from a
    camera without response.
    """
    response = camera.response
    if response is None:
        return np.minimum(radiance, MAX_HALF).astype(np.float16)
    if camera.mosaic:
        radiance = through_mosaic(radiance, camera.mosaic)[..., None]
    relative = 1.0 if exposure_s is None else exposure_s / response.exposure_s
    signal = response.signal(radiance * relative) + pattern
    if camera.noise_codes > 0:
        signal += np.random.default_rng(seed).normal(0.0, camera.noise_codes, signal.shape)
    codes = code_from_signal(signal, response).astype(np.float32)
    return codes[..., 0] if camera.mosaic else codes


def through_mosaic(rgb: np.ndarray, mosaic: Mosaic) -> np.ndarray:
    """What a sensor with these colour filters sees of (height, width, 3), (height, width); a monochrome one sees the mean."""
    if mosaic == "mono":
        return rgb.mean(axis=-1)
    filtered = np.empty(rgb.shape[:2], rgb.dtype)
    for n, colour in enumerate(mosaic):
        filtered[n // 2 :: 2, n % 2 :: 2] = rgb[n // 2 :: 2, n % 2 :: 2, "RGB".index(colour)]
    return filtered


class SequenceWriter:
    """Writes a folder of a virtual camera's frames with lens.toml, response.toml and manifest.jsonl beside them."""

    def __init__(self, folder: Path, name: str, camera: VirtualCamera):
        """Makes the folder and writes all but the frames; an existing manifest is replaced."""
        self._folder, self._name = folder, name
        folder.mkdir(parents=True, exist_ok=True)
        write_lens(folder / "lens.toml", camera.lens)
        self._attributes: dict[str, Any] = {
            "framesPerSecond": Fraction(camera.fps).limit_denominator(1001),
            "vemlight:kind": "fisheye" if camera.response is None else "codes",
        }
        if camera.exposures:  # and not which of them a frame has, as no driver tells it
            self._attributes[EXPOSURES] = exposures_text(tuple(sorted(camera.exposures, reverse=True)))
        if camera.exposure_s > 0:
            self._attributes["expTime"] = camera.exposure_s
        if camera.response is not None:
            write_response(folder / "response.toml", camera.response)
            self._attributes["colorInteropID"] = "data"  # codes are no colours
        if camera.mosaic is not None:
            self._attributes["vemlight:mosaic"] = camera.mosaic
        (folder / MANIFEST).unlink(missing_ok=True)
        self._manifest = ManifestWriter(folder, [folder / name for name in ("lens.toml", "response.toml") if (folder / name).exists()])

    def name(self, k: int) -> str:
        """File name of frame `k`."""
        return f"{self._name}_{k:04d}.exr"

    def write(self, k: int, time_s: float, pixels: np.ndarray) -> None:
        """Writes frame `k` and its line of the manifest."""
        path = self._folder / self.name(k)
        write_exr(path, pixels, {**self._attributes, "imageCounter": k, "vemlight:time_s": repr(time_s)})
        self._manifest.add(path, k, time_s)

    def close(self, *beside: Path) -> None:
        """Ends the manifest, with `beside`, other files of the folder that belong to the sequence."""
        self._manifest.close(beside)
