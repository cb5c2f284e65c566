"""Image files: radiance as OpenEXR and Radiance HDR, pictures as PNG, with the metadata that other programs read.

Every failure to read is one UserError naming the file, whatever the library below raises. A file is written under another name and
renamed when it is complete.
"""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from vemlight.errors import UserError
from vemlight.files import written_whole

MAX_SIDE = 16384  # pixels: of the largest lat-long maps and above any camera's; a larger number in a header is damage or an attack
MAX_PIXELS = 2**27  # 16384 x 8192, such a map: 1.6 GB as float32 RGB
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x, y of red, green, blue, white (D65)
_terminal = threading.Lock()


class _OtherThreads:
    """A text stream that drops what the thread that made it writes, and passes on what other threads write."""

    def __init__(self, stream: Any) -> None:
        self._stream, self._thread, self._lock = stream, threading.get_ident(), threading.Lock()

    def write(self, text: str) -> int:
        if threading.get_ident() == self._thread:
            return len(text)
        with self._lock:
            return self._stream.write(text)

    def pass_to(self, stream: Any) -> None:
        with self._lock:
            self._stream.flush()
            self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def silent() -> Iterator[None]:
    """Suppresses what OpenEXR and OpenCV print about a damaged file, so that our own line is the only one.

    What other threads print meanwhile through sys.stdout and sys.stderr is shown.
    """
    with _terminal, open(os.devnull, "w") as null, os.fdopen(os.dup(2), "w", buffering=1) as terminal:
        stdout, stderr = sys.stdout, sys.stderr
        out, err = _OtherThreads(stdout), _OtherThreads(terminal if _descriptor(stderr) == 2 else stderr)
        sys.stdout, sys.stderr = out, err
        os.dup2(null.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(terminal.fileno(), 2)
            # What another thread has put there meanwhile stays.
            sys.stdout = stdout if sys.stdout is out else sys.stdout
            sys.stderr = stderr if sys.stderr is err else sys.stderr
            err.pass_to(stderr)  # a thread that took it as sys.stderr may write later


def _descriptor(stream: Any) -> int:
    try:
        return stream.fileno()
    except (AttributeError, OSError, ValueError):  # a stream in memory, or none
        return -1


def read_radiance(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """Reads an image (height, width, 3) float32, linear Rec. 709, and the EXR's attributes (none for .hdr).

    Gray files are repeated in three channels; alpha is left out. nan, inf and negative pixels are preserved.
    Raises UserError for a file that is missing, damaged, too large or of another kind.
    """
    if not path.is_file():
        raise UserError(f"{path}: there is no such file; check the path")
    if path.suffix.lower() == ".exr":
        return _read_exr(path)
    if path.suffix.lower() in (".hdr", ".pic"):
        return _read_hdr(path), {}
    raise UserError(f"{path}: radiance is read from .exr and .hdr, not {path.suffix or 'a file without suffix'}; convert it")


def _read_exr(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    import OpenEXR

    try:
        with silent():
            OpenEXR.setMaxImageSize(0, 0)  # OpenEXR's own limit would not say what is wrong
            for part in OpenEXR.File(str(path), header_only=True).parts:
                low, high = part.header["dataWindow"]
                _check_size(path, *(high.astype(int) - low + 1))
            file = OpenEXR.File(str(path))
            channels = {name: channel.pixels for name, channel in file.channels().items()} if file.parts else {}
            attributes = dict(file.header()) if file.parts else {}
    except UserError:
        raise
    except (RuntimeError, ValueError, TypeError, KeyError, MemoryError, IndexError) as error:
        raise UserError(f"{path}: is not a readable EXR ({one_line(error)}); it may be truncated, copy it again") from error
    if not channels:
        raise UserError(f"{path}: is not a readable EXR (no image in it); it may be truncated, copy it again")
    for name in ("RGB", "RGBA", "Y"):
        if name in channels:
            pixels = channels[name]
            break
    else:
        if not {"R", "G", "B"} <= channels.keys():
            raise UserError(f"{path}: has channels {', '.join(sorted(channels))} but no R, G, B or Y; export it as RGB")
        pixels = np.stack([channels[c] for c in "RGB"], axis=-1)
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[..., None], 3, axis=-1)
    return np.ascontiguousarray(pixels[..., :3], np.float32), attributes


def _check_size(path: Path, width: int, height: int) -> None:
    # before memory is allocated for the pixels
    if max(width, height) > MAX_SIDE or width * height > MAX_PIXELS:
        limits = f"at most {MAX_SIDE} on a side and {MAX_PIXELS} in all are read"
        raise UserError(f"{path}: has {width}x{height} pixels and {limits}; scale it down")


def _read_hdr(path: Path) -> np.ndarray:
    import cv2

    try:
        with silent():
            pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise UserError(f"{path}: is not a readable Radiance HDR ({one_line(error)}); copy it again") from error
    if pixels is None or pixels.dtype != np.float32 or pixels.ndim != 3:
        raise UserError(f"{path}: is not a readable Radiance HDR; it may be truncated, copy it again")
    return np.ascontiguousarray(pixels[..., ::-1])


def read_codes(path: Path) -> np.ndarray:
    """Reads an image's values without conversion, (height, width) or (height, width, 3) RGB: EXR, or 8 or 16 bits of PNG, TIFF, JPEG.

    Raises UserError for a file that is missing, damaged or of another kind.
    """
    if path.suffix.lower() == ".exr":
        return read_radiance(path)[0]
    import cv2

    if not path.is_file():
        raise UserError(f"{path}: there is no such file; check the path")
    with silent():
        pixels = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    if pixels is None:
        raise UserError(f"{path}: is no readable image; give PNG, TIFF, JPEG or EXR")
    return pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[..., ::-1])


def one_line(error: BaseException) -> str:
    """The message of an error of a library, on one line and at most 200 characters long."""
    return " ".join(str(error).split())[:200]


def write_exr(path: Path, pixels: np.ndarray, attributes: dict[str, Any] | None = None) -> None:
    """Writes (height, width), (.., 3) or (.., 4) pixels as Y, RGB or RGBA; float16 stays half, all else becomes 32-bit float.

    `attributes` join the standard ones (chromaticities, colorInteropID) in the header; integers above 31 bits must come as strings.
    Raises OSError when the disk refuses.
    """
    import OpenEXR

    dtype = np.float16 if pixels.dtype == np.float16 else np.float32
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709,
        "colorInteropID": "lin_rec709_scene",
        **(attributes or {}),
    }
    name = "Y" if pixels.ndim == 2 else {3: "RGB", 4: "RGBA"}[pixels.shape[2]]
    with written_whole(path) as part:
        try:
            with OpenEXR.File(header, {name: np.ascontiguousarray(pixels, dtype)}) as file:
                file.write(str(part))
        except RuntimeError as error:
            raise OSError(f"{path}: {one_line(error)}") from error


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Writes (height, width), (.., 3) or (.., 4) uint8 or uint16 pixels, RGB order. Raises OSError when the disk refuses."""
    import cv2

    order = pixels if pixels.ndim == 2 else pixels[..., [2, 1, 0, 3][: pixels.shape[2]]]
    done, data = cv2.imencode(".png", order)
    if not done:
        raise OSError(f"{path}: the PNG encoder refused an image of shape {pixels.shape}")
    with written_whole(path) as part:
        part.write_bytes(data.tobytes())
