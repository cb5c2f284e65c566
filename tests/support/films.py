"""Small films whose colours are known: linear light through a curve, primaries and a matrix into codes, and a lossless encoder."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np

from vemlight.capture.planes import SUBSAMPLING
from vemlight.light.primaries import PRIMARIES, rec709_from_primaries
from vemlight.light.transfers import TRANSFERS

H273 = {
    "transfer": {"bt709": 1, "srgb": 13, "pq": 16, "hlg": 18, "linear": 8},
    "primaries": {"bt709": 1, "bt2020": 9, "p3d65": 12},
    "matrix": {"rgb": 0, "bt709": 1, "bt601": 6, "bt2020": 9},
    "range": {"limited": 1, "full": 2},
}
LUMA = {"bt601": (0.299, 0.587, 0.114), "bt709": (0.2126, 0.7152, 0.0722), "bt2020": (0.2627, 0.6780, 0.0593)}


class Film(NamedTuple):
    """How a film is coded. tagged: which of the four the file says."""

    transfer: str = "bt709"
    primaries: str = "bt709"
    matrix: str = "bt709"
    range: str = "limited"
    pixels: str = "yuv444p10le"
    codec: str = "ffv1"
    tagged: tuple[str, ...] = ("transfer", "primaries", "matrix", "range")
    options: dict[str, str] = {}  # noqa: RUF012


def signal_of_light(light: np.ndarray, transfer: str) -> np.ndarray:
    """The signals of a curve whose light is this, by searching in the curve."""
    signals = np.linspace(0, 1, 2**18)
    return np.interp(light, TRANSFERS[transfer].light_from_signal(signals), signals)


def codes_of(rgb: np.ndarray, film: Film) -> list[np.ndarray]:
    """The planes of linear Rec. 709 pixels (height, width, 3): G, B, R of an RGB format, else Y, Cb, Cr; colour is a block's mean."""
    signals = signal_of_light(rgb @ np.linalg.inv(rec709_from_primaries(PRIMARIES[film.primaries])).T, film.transfer)
    bits = int("".join(filter(str.isdigit, film.pixels.partition("p")[2])) or 8)
    unit, top = 2 ** (bits - 8), 2**bits - 1
    black, span, chroma_span = (16 * unit, 219 * unit, 224 * unit) if film.range == "limited" else (0, top, top)
    if film.pixels.startswith("gbr"):
        return [np.rint(black + span * signals[..., n]).astype(np.uint16) for n in (1, 2, 0)]
    luma = signals @ LUMA[film.matrix]
    blue, red = ((signals[..., n] - luma) / (2 - 2 * LUMA[film.matrix][n]) for n in (2, 0))
    across, down = (2**n for n in SUBSAMPLING[film.pixels[4 if film.pixels[3] in "aj" else 3 :][:3]])
    height, width = luma.shape
    blocks = [c.reshape(height // down, down, width // across, across).mean(axis=(1, 3)) for c in (blue, red)]
    planes = [black + span * luma, *(2 ** (bits - 1) + chroma_span * c for c in blocks)]
    return [np.rint(np.clip(plane, 0, top)).astype(np.uint16) for plane in planes]


def write_film(path: Path, pictures: Sequence[np.ndarray], film: Film, fps: int = 25, metadata: dict[str, str] | None = None) -> None:
    """Writes linear Rec. 709 pictures (height, width, 3) as a film."""
    tags = {key: H273[key][getattr(film, key)] if key in film.tagged else {"range": 0}.get(key, 2) for key in H273}
    height, width = pictures[0].shape[:2]
    with av.open(str(path), "w") as container:
        stream = container.add_stream(film.codec, rate=fps, options=dict(film.options))
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.pix_fmt = width, height, film.pixels
        stream.metadata.update(metadata or {})
        context = stream.codec_context
        context.color_trc, context.color_primaries = tags["transfer"], tags["primaries"]
        context.colorspace, context.color_range = tags["matrix"], tags["range"]
        for number, picture in enumerate(pictures):
            frame = frame_of(codes_of(picture, film), width, height, film.pixels)
            frame.pts, frame.time_base = number, Fraction(1, fps)
            frame.color_trc, frame.color_primaries = tags["transfer"], tags["primaries"]
            frame.colorspace, frame.color_range = tags["matrix"], tags["range"]
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def frame_of(planes: Sequence[np.ndarray], width: int, height: int, pixels: str) -> av.VideoFrame:
    """A frame with these planes of codes."""
    frame = av.VideoFrame(width, height, pixels)
    for plane, codes in zip(frame.planes, planes, strict=False):
        dtype = np.uint8 if plane.line_size < 2 * codes.shape[1] or pixels[-1] == "p" else np.uint16
        rows = np.frombuffer(plane, dtype)  # type: ignore[call-overload]  # PyAV's types leave out that a plane is a buffer
        rows = rows.reshape(-1, plane.line_size // np.dtype(dtype).itemsize)
        rows[: codes.shape[0], : codes.shape[1]] = codes
    return frame


def lamp_room(height: int, power: float = 1.0) -> np.ndarray:
    """A lat-long picture (height, 2 height, 3), linear Rec. 709: a sky, a coloured ground, and four lamps of different colours."""
    width = 2 * height
    picture = np.empty((height, width, 3))
    picture[: height // 2], picture[height // 2 :] = (0.05, 0.07, 0.10), (0.06, 0.04, 0.03)
    side = height // 16
    for n, colour in enumerate([(1.0, 0.9, 0.7), (0.8, 0.3, 0.2), (0.3, 0.7, 0.35), (0.25, 0.3, 0.9)]):
        y, x = (2 + 3 * n) * side // 2 // 2 * 2, (2 * n + 1) * width // 8 // 4 * 4
        picture[y : y + side, x : x + side] = colour
    return picture * power
