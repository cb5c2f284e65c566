"""OpenEXR images as radiance: the pixels that the display window shows, in linear Rec. 709, from the layer that was asked for.

The OpenEXR library decodes; what its Python form stumbles over in a header (text that is not UTF-8, a rate of 0/0) is set right before, and
sizes are checked before anything is allocated. Format: "OpenEXR File Layout", openexr.com.
"""

import io
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.errors import UserError
from vemlight.file_kinds import BINARY_UNTIL, check_kind
from vemlight.files import notice, one_line, read_file
from vemlight.light.image_limits import LIMITS, MAX_IMAGE_BYTES, ImageLimits
from vemlight.light.primaries import D65, PRIMARIES, REC709, XYZ, rec709_from_primaries, xyz_from_primaries
from vemlight.light.quiet import silent

MAGIC = b"\x76\x2f\x31\x01"
SINGLE_TILED, DEEP, MULTIPART = 0x200, 0x800, 0x1000  # flags in the version field
HALF = 1  # the number of a channel's type; the other two take four bytes
ADOBE_RGB = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, *D65)  # Adobe RGB (1998), 4.3.1
MAX_PARTS = 1024  # of a file; renderers write a part a layer, some dozens
MAX_CHANNELS = 1024  # of a part; renderers write some hundreds
# Linear spaces by their names ("Color Interop IDs", ASWF 2024), and names that say nothing.
INTEROP = {
    "lin_rec709_scene": REC709, "lin_p3d65_scene": PRIMARIES["p3d65"], "lin_rec2020_scene": PRIMARIES["bt2020"],
    "lin_ap0_scene": PRIMARIES["ap0"], "lin_ap1_scene": PRIMARIES["ap1"], "lin_adobergb_scene": ADOBE_RGB,
    "lin_ciexyzd65_scene": (*XYZ, *D65), "data": None, "unknown": None, "none": None,
}  # fmt: skip
MAIN_LAYERS = ("", "rgba", "rgb", "beauty", "combined", "main", "color")  # names of what is the picture itself, in this order


class ExrAttribute(NamedTuple):
    """An attribute's type and where its value lies in the file: [begin, end)."""

    kind: str
    begin: int
    end: int


class Layer(NamedTuple):
    """Channels that make one picture: of the part `part`, those whose names begin with `prefix`. name: as the user may ask for it."""

    part: int
    prefix: str
    name: str
    is_gray: bool


PLAIN = Layer(0, "", "", False)


def read_exr(path: Path, layer: str = "", limits: ImageLimits = LIMITS) -> tuple[np.ndarray, dict[str, Any]]:
    """(height, width, 3) float32, linear Rec. 709, and the attributes of the part that it comes from.

    Gray is repeated in three channels, luminance with chroma becomes RGB, alpha is left out. nan, inf and negative pixels come as they are.
    layer: such as "ViewLayer.Combined", or a part's name; empty: the picture itself, and a notice names what was taken where several are.
    Raises UserError, by its cause, for a file that is damaged, too large, deep, a cube map, or has no such layer.
    """
    data, headers = _checked(path, limits)
    with _one_line(path):
        plain = not layer and len(headers) == 1 and _is_plain_rgb(data, headers[0])
        parts = _decoded(path, data, headers, separate_channels=not plain)
        found = PLAIN if plain else _layer(path, [(part.name() or "", tuple(part.channels)) for part in parts], layer)
        part = parts[found.part]
        attributes = dict(part.header)
        channels = {name.removeprefix(found.prefix): part.channels[name] for name in part.channels if name.startswith(found.prefix)}
        planes = {name: (channel.pixels, channel.xSampling, channel.ySampling) for name, channel in channels.items()}
    if str(attributes.get("envmap")).endswith("CUBE"):
        raise UserError(f"{path}: is a cube map by its header (envmap); make it lat-long first: exrenvmap -l")
    _name_primaries(path, attributes)
    try:
        primaries = tuple(attributes.get("chromaticities", REC709))
        pixels = _rgb(path, planes, primaries if any(primaries) else REC709, found.is_gray)
    except UserError:
        raise
    except (ValueError, TypeError) as error:  # TypeError: an attribute of that name and another type
        raise UserError(f"{path}: chromaticities in its header: {error}; write it again with the right ones") from error
    return _in_display_window(path, pixels, attributes), attributes


def _name_primaries(path: Path, attributes: dict[str, Any]) -> None:
    """Gives `attributes` the chromaticities that are said by a name alone. Raises UserError for a space that is not linear."""
    name = str(attributes.get("colorInteropID", "")).lower()
    if name and name not in INTEROP and not name.startswith("lin_"):
        raise UserError(f"{path}: its values are not linear by its header (colorInteropID {name[:40]}); convert it to a linear space")
    known = INTEROP.get(name)
    if known is None and attributes.get("acesImageContainerFlag") == 1:
        known = PRIMARIES["ap0"]  # SMPTE ST 2065-4
    if known and not any(attributes.get("chromaticities", ())):
        attributes["chromaticities"] = known
    elif name.startswith("lin_") and name not in INTEROP and "chromaticities" not in attributes:
        raise UserError(f"{path}: its primaries are not known by their name (colorInteropID {name[:40]}); write its chromaticities")


def read_parts(path: Path, limits: ImageLimits = LIMITS) -> list[Any]:
    """The parts of an EXR as OpenEXR gives them, R, G and B of a part as one channel RGB. Raises UserError as `read_exr`."""
    data, headers = _checked(path, limits)
    with _one_line(path):
        return _decoded(path, data, headers, separate_channels=False)


@contextmanager
def _one_line(path: Path) -> Iterator[None]:
    """Makes a UserError that names the file of whatever is raised over its content."""
    try:
        yield
    except UserError:
        raise
    except (struct.error, IndexError, KeyError) as error:
        raise UserError(f"{path}: its EXR header is cut off; copy it again") from error
    except (RuntimeError, ValueError, TypeError, MemoryError, OSError, OverflowError) as error:
        raise UserError(f"{path}: is not a readable EXR ({one_line(error)}); it may be truncated, copy it again") from error


def _checked(path: Path, limits: ImageLimits) -> tuple[bytearray, list[dict[str, ExrAttribute]]]:
    """A file's bytes and the attributes of its parts, once the headers have shown that it is not too large."""
    data = bytearray(read_file(path, MAX_IMAGE_BYTES))
    check_kind(path, bytes(data[:BINARY_UNTIL]), "an OpenEXR picture")
    with _one_line(path):
        headers = list(_headers(data))
        _check_sizes(path, data, headers, limits)
    return data, headers


def _decoded(path: Path, data: bytearray, headers: list[dict[str, ExrAttribute]], separate_channels: bool) -> list[Any]:
    import OpenEXR

    OpenEXR.setMaxImageSize(LIMITS.side, LIMITS.side)
    OpenEXR.setMaxTileSize(LIMITS.side, LIMITS.side)
    is_text = str(path).isprintable()  # half characters, of names that are not UTF-8, are not: OpenEXR takes none
    source = io.BytesIO(data) if _made_legible(data, headers) or not is_text else str(path)
    with silent():
        parts = OpenEXR.File(source, separate_channels=separate_channels).parts
    if len(parts) != len(headers):  # the library leaves out those whose pixels it cannot read
        raise UserError(f"{path}: pixels of {len(headers) - len(parts)} of its {len(headers)} parts are missing or damaged; copy it again")
    return parts


def _headers(data: bytearray) -> Iterator[dict[str, ExrAttribute]]:
    """The attributes of each part's header. Raises struct.error or IndexError where it is cut off, ValueError for another kind of file."""
    if data[:4] != MAGIC:
        raise ValueError("it does not begin as one")
    (version,) = struct.unpack_from("<I", data, 4)
    at = 8
    for _ in range(MAX_PARTS + 1):  # and the empty header that ends them
        attributes: dict[str, ExrAttribute] = {}
        while data[at]:
            name, at = _text(data, at)
            kind, at = _text(data, at)
            (size,) = struct.unpack_from("<i", data, at)
            if size < 0 or at + 4 + size > len(data):
                raise struct.error("an attribute reaches beyond the file")
            attributes[name] = ExrAttribute(kind, at + 4, at + 4 + size)
            at += 4 + size
        at += 1
        if not attributes:
            return
        yield attributes
        if not version & MULTIPART:
            return
    raise ValueError(f"more than {MAX_PARTS} parts")


def _text(data: bytearray, at: int) -> tuple[str, int]:
    """The text from `at` to the next NUL, and the place behind that."""
    end = data.index(0, at, at + 256) if 0 in data[at : at + 256] else -1
    if end < 0:
        raise struct.error("a name without an end")
    return data[at:end].decode("latin-1"), end + 1


def _check_sizes(path: Path, data: bytearray, headers: list[dict[str, ExrAttribute]], limits: ImageLimits) -> None:
    """Raises UserError for deep images and for more pixels than are allowed, in all parts and channels together."""
    pixels = decoded_bytes = 0
    for attributes in headers:
        kind = attributes.get("type")
        if kind and bytes(data[kind.begin : kind.end]).startswith(b"deep"):
            raise UserError(f"{path}: holds deep pixels, many depths in each; flatten it")
        for name in ("dataWindow", "displayWindow"):
            left, top, right, bottom = struct.unpack_from("<4i", data, attributes[name].begin)
            limits.check(path, right - left + 1, bottom - top + 1, len(data))
            if name == "dataWindow":
                area = (right - left + 1) * (bottom - top + 1)
                pixels += area
                decoded_bytes += area * _bytes_per_pixel(data, attributes["channels"])
    if pixels > limits.pixels:
        raise UserError(f"{path}: has {pixels} pixels in its {len(headers)} parts, {limits.pixels} are read; keep the part that is needed")
    if decoded_bytes > limits.most_bytes(len(data)):
        raise UserError(f"{path}: its channels decode to {decoded_bytes} bytes from {len(data)}, which no picture does; copy it again")


def _bytes_per_pixel(data: bytearray, channels: ExrAttribute) -> int:
    """Of all channels together."""
    _, at, end = channels
    total = count = 0
    while at < end - 1:
        count += 1
        if count > MAX_CHANNELS:
            raise ValueError(f"more than {MAX_CHANNELS} channels")
        _, at = _text(data, at)
        total += 2 if struct.unpack_from("<i", data, at) == (HALF,) else 4
        at += 16  # type, linearity, sampling
    return total


def _is_plain_rgb(data: bytearray, attributes: dict[str, ExrAttribute]) -> bool:
    """Whether the channels are R, G, B and perhaps A, all alike: the library then gives them interleaved, in half the time."""
    _, at, end = attributes["channels"]
    names, forms = "", set()
    while at < end - 1:
        name, at = _text(data, at)
        names += f"{name} "
        forms.add(bytes(data[at : at + 16]))  # type and sampling
        at += 16
    return names in ("B G R ", "A B G R ") and len(forms) == 1 and struct.unpack_from("<2i", next(iter(forms)), 8) == (1, 1)


def _made_legible(data: bytearray, headers: list[dict[str, ExrAttribute]]) -> bool:
    """Sets right in place what the library's Python form refuses: text that is not UTF-8, fractions with a denominator of 0 (become 0/1).

    Returns whether anything was changed.
    """
    changed = False
    for attributes in headers:
        for kind, begin, end in attributes.values():
            if kind in ("string", "stringvector"):
                try:
                    data[begin:end].decode()
                except UnicodeDecodeError:
                    changed = True
                    data[begin:end] = bytes(code if code < 128 else ord("?") for code in data[begin:end])
            elif kind == "rational" and end - begin == 8 and struct.unpack_from("<I", data, begin + 4) == (0,):
                struct.pack_into("<iI", data, begin, 0, 1)
                changed = True
    return changed


def _layer(path: Path, parts: list[tuple[str, tuple[str, ...]]], wanted: str) -> Layer:
    """The layer to read, of all parts' names and channels. Raises UserError when there is none, or several of equal right."""
    layers = [layer for number, (name, channels) in enumerate(parts) for layer in _layers_of(number, name, channels)]
    if not layers:
        channels = ", ".join(sorted(channel for _, names in parts for channel in names)) or "none"
        wanted = "no R, G, B and no Y of a luminance in one part"
        raise UserError(f"{path}: has channels {channels[:200]}: {wanted}; export it as RGB")
    names = ", ".join(dict.fromkeys(layer.name or "(unnamed)" for layer in layers))
    if wanted:
        chosen = [layer for layer in layers if layer.name == wanted] or [layer for layer in layers if layer.name.lower() == wanted.lower()]
        if not chosen:
            raise UserError(f"{path}: has no layer {wanted}; choose from {names[:300]}")
        return chosen[0]
    if len(layers) == 1:
        return layers[0]

    def rank(layer: Layer) -> tuple[bool, int]:
        last = layer.name.rpartition(".")[2].lower()
        return layer.is_gray, MAIN_LAYERS.index(last) if last in MAIN_LAYERS else len(MAIN_LAYERS)

    best = min(layers, key=rank)
    if rank(best)[1] == len(MAIN_LAYERS) and sum(rank(layer) == rank(best) for layer in layers) > 1:
        raise UserError(f"{path}: has several layers and none is the picture itself by its name; choose with --layer: {names[:300]}")
    if sum(not layer.is_gray for layer in layers) > 1:
        notice(f"{path}: layer {best.name or '(unnamed)'} was taken of {names[:300]}; --layer NAME takes another")
    return best


def _layers_of(number: int, part: str, channels: tuple[str, ...]) -> Iterator[Layer]:
    """The layers of one part: each prefix with R, G and B, or with a luminance Y, which in X, Y and Z is another number."""
    prefixes = dict.fromkeys(name[: name.rfind(".") + 1] for name in channels)
    for prefix in prefixes:
        has = {name.removeprefix(prefix) for name in channels if name.startswith(prefix)}
        name = ".".join(filter(None, (part, prefix.rstrip("."))))
        if {"R", "G", "B"} <= has:
            yield Layer(number, prefix, name, False)
        elif "Y" in has and not has & {"X", "Z"} and ("RY" in has) == ("BY" in has):
            yield Layer(number, prefix, name, "RY" not in has)


def _rgb(path: Path, planes: Mapping[str, tuple[np.ndarray, int, int]], primaries: tuple[float, ...], is_gray: bool) -> np.ndarray:
    """(height, width, 3) float32 in Rec. 709. Raises ValueError for primaries that are none, UserError for channels of several sizes."""
    for name in ("RGB", "RGBA"):
        if name in planes:
            return _in_rec709(np.asarray(planes[name][0][..., :3], np.float32), primaries)
    if is_gray:
        return np.repeat(np.asarray(planes["Y"][0], np.float32)[..., None], 3, axis=-1)
    if {"R", "G", "B"} <= planes.keys():
        if any(planes[name][1:] != (1, 1) for name in "RGB"):
            raise UserError(f"{path}: R, G or B has fewer pixels than its window (subsampled); export it whole")
        pixels = np.stack([np.asarray(planes[name][0], np.float32) for name in "RGB"], axis=-1)
    else:
        pixels = _rgb_from_luminance_chroma(planes, xyz_from_primaries(primaries)[1])
    return _in_rec709(pixels, primaries)


def _in_rec709(pixels: np.ndarray, primaries: tuple[float, ...]) -> np.ndarray:
    """(.., 3) float32 of pixels with these primaries, which come through untouched where they are Rec. 709's to a thousandth."""
    if np.allclose(primaries, REC709, atol=1e-3):
        return pixels
    return (pixels @ rec709_from_primaries(primaries).T).astype(np.float32)


def _rgb_from_luminance_chroma(planes: Mapping[str, tuple[np.ndarray, int, int]], luma: np.ndarray) -> np.ndarray:
    """RGB of Y, RY = (R - Y) / Y and BY = (B - Y) / Y, the two often stored for blocks of pixels ("Technical Introduction to OpenEXR")."""
    luminance = np.asarray(planes["Y"][0], np.float32)
    red, blue = ((1 + _whole(*planes[name], luminance.shape)) * luminance for name in ("RY", "BY"))
    green = (luminance - luma[0] * red - luma[2] * blue) / luma[1]
    return np.maximum(np.stack([red, green, blue], axis=-1), 0).astype(np.float32)


def _whole(plane: np.ndarray, across: int, down: int, shape: tuple[int, ...]) -> np.ndarray:
    """A subsampled plane at each pixel of `shape`: each value holds in its whole block, so that a lamp's colour stays at the lamp."""
    plane = np.asarray(plane, np.float32)
    return np.repeat(np.repeat(plane, down, axis=0), across, axis=1)[: shape[0], : shape[1]]


def _in_display_window(path: Path, pixels: np.ndarray, attributes: Mapping[str, Any]) -> np.ndarray:
    """The picture that the display window shows: black where no pixels are stored, without those that lie outside."""
    (left, top), _ = (np.asarray(corner).tolist() for corner in attributes["dataWindow"])
    (first, above), (last, below) = (np.asarray(corner).tolist() for corner in attributes["displayWindow"])
    height, width = pixels.shape[:2]
    if (left, top, height, width) == (first, above, below - above + 1, last - first + 1):
        return np.ascontiguousarray(pixels)
    shown = np.zeros((below - above + 1, last - first + 1, 3), np.float32)
    rows = slice(max(top, above), min(top + height, below + 1))
    cols = slice(max(left, first), min(left + width, last + 1))
    if rows.start < rows.stop and cols.start < cols.stop:
        stored = pixels[rows.start - top : rows.stop - top, cols.start - left : cols.stop - left]
        shown[rows.start - above : rows.stop - above, cols.start - first : cols.stop - first] = stored
    else:
        notice(f"{path}: none of its pixels lie in its display window, so it is black")
    return shown
