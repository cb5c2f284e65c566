"""Material libraries of OBJ files (.mtl): diffuse colours and their images (Wavefront, "Object Files", appendix B2)."""

from typing import NamedTuple

import numpy as np

from vemlight.light.colour import linear_from_srgb
from vemlight.renderer.scene.files_beside import FilesBeside
from vemlight.renderer.scene.materials import Colour, Phong
from vemlight.renderer.scene.textures import Texture

WHITE: Colour = (1.0, 1.0, 1.0)
# Options of an image and how many words may follow each.
OPTIONS = {
    "-blendu": 1, "-blendv": 1, "-bm": 1, "-boost": 1, "-cc": 1, "-clamp": 1, "-imfchan": 1, "-mm": 2, "-o": 3, "-s": 3, "-t": 3,
    "-texres": 1, "-type": 1,
}  # fmt: skip
VECTORS = ("-o", "-s", "-t")  # of which all but the first number may be left out
HARMLESS = ("-blendu", "-blendv", "-bm", "-boost", "-cc", "-texres", "-type")  # how other programs filter; -bm is for bumps
MAX_MATERIALS = 20_000


class ImageStatement(NamedTuple):
    """`map_Kd`: the name of an image, and the words of each of its options."""

    name: str
    options: dict[str, list[str]]


class MtlMaterial(NamedTuple):
    """A material of a library. diffuse: linear. ignored: statements that would change how it looks and are not read."""

    diffuse: Colour = WHITE
    image: ImageStatement | None = None
    ignored: tuple[str, ...] = ()


def read_mtl(content: bytes, beside: FilesBeside) -> dict[str, MtlMaterial]:
    """The materials of a library by their names. What is not as the format has it is left out with a line."""
    materials: dict[str, MtlMaterial] = {}
    name = None
    for line in content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").replace(b"\r", b"\n").split(b"\n"):
        key, _, rest = line.decode("utf-8", "replace").strip().replace("\t", " ").partition(" ")
        rest, words = rest.strip(), rest.split()
        if key.lower() == "newmtl":
            name = rest
            if len(materials) >= MAX_MATERIALS:
                raise ValueError(f"has more than {MAX_MATERIALS} materials in a library")
            materials[name] = MtlMaterial()
        elif name is not None and rest:
            materials[name] = _with_statement(materials[name], name, key.lower(), rest, words, beside)
    return materials


def _with_statement(made: MtlMaterial, name: str, key: str, rest: str, words: list[str], beside: FilesBeside) -> MtlMaterial:
    """A material with one statement more."""
    match key:
        case "kd":
            colour = _colour(words)
            if colour is None:
                beside.leave_out(f"material {name[:60]}: Kd {rest[:60]} is left out: three numbers are read")
                return made
            return made._replace(diffuse=colour)
        case "map_kd":
            return made._replace(image=_image_statement(rest))
        case "d" | "tr":
            numbers = [word for word in words if word != "-halo"]
            opaque = _number(numbers[0]) == (1.0 if key == "d" else 0.0) if numbers else True
            return made if opaque else made._replace(ignored=(*made.ignored, "d" if key == "d" else "Tr"))
        case "map_d":
            return made._replace(ignored=(*made.ignored, "map_d"))
        case "ke" if any(_number(word) for word in words):
            return made._replace(ignored=(*made.ignored, "Ke"))
        case _:
            return made


def phong_from_mtl(name: str, found: MtlMaterial, beside: FilesBeside) -> Phong:
    """The material of a library as it is drawn: its image times its colour."""
    if found.ignored:
        beside.leave_out(f"material {name[:60]}: its {' and '.join(dict.fromkeys(found.ignored))} is not drawn")
    texels = beside.texels(found.image.name) if found.image else None
    if found.image is None or texels is None:
        return Phong(found.diffuse)
    if not any(found.diffuse):
        beside.leave_out(f"material {name[:60]}: its Kd of 0 makes its image black")
    return Phong(found.diffuse, colour_map=_texture(name, found.image, texels, beside))


def _texture(name: str, image: ImageStatement, texels: np.ndarray, beside: FilesBeside) -> Texture:
    scale, offset = (np.array(_vector(image.options.get(key, []), default)) for key, default in (("-s", 1.0), ("-o", 0.0)))
    for option in image.options.keys() - {*HARMLESS, "-s", "-o", "-clamp"}:
        beside.leave_out(f"material {name[:60]}: option {option} of its image is left out")
    moved = None if (scale == 1).all() and (offset == 0).all() else np.column_stack([np.diag(scale), offset])
    repeats = image.options.get("-clamp", [""])[0].lower() != "on"
    return Texture(texels, repeats=(repeats, repeats), uv_transform=moved)


def _image_statement(rest: str) -> ImageStatement:
    """An image's options and its name, which may have spaces in it."""
    options: dict[str, list[str]] = {}
    while rest.startswith("-"):
        option, _, after = rest.partition(" ")
        if option.lower() not in OPTIONS:
            break
        values: list[str] = []
        after = after.strip()
        while len(values) < OPTIONS[option.lower()] and " " in after:
            word, _, behind = after.partition(" ")
            if values and option.lower() in VECTORS and _number(word) is None:
                break
            values.append(word)
            after = behind.strip()
        options[option.lower()], rest = values, after
    return ImageStatement(rest.strip('"'), options)


def _vector(words: list[str], default: float) -> tuple[float, float]:
    """The first two numbers of an option, `default` for those that are left out or none."""
    numbers = [number for word in words[:2] if (number := _number(word)) is not None]
    first, second = (*numbers, default, default)[:2]
    return first, second


def _colour(words: list[str]) -> Colour | None:
    """A colour, sRGB-coded in 0 .. 1, made linear; one number is gray. None for what is none, such as a spectral file."""
    numbers = [number for word in words if (number := _number(word)) is not None]
    if len(numbers) != len(words) or len(numbers) not in (1, 3):
        return None
    red, green, blue = linear_from_srgb(np.clip(np.array(numbers * (3 // len(numbers))), 0, 1)).tolist()
    return red, green, blue


def _number(word: str) -> float | None:
    try:
        number = float(word)
    except ValueError:
        return None
    return number if np.isfinite(number) else None
