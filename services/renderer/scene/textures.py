"""Images on surfaces: their texels in linear light, how they are filtered and how texture coordinates address them."""

import io
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from vemlight.light.colour import linear_from_srgb
from vemlight.light.image_limits import ImageLimits
from vemlight.light.quiet import silent

LINEAR, LINEAR_MIPMAP_LINEAR = 0x2601, 0x2703  # OpenGL's GL_LINEAR and GL_LINEAR_MIPMAP_LINEAR
MAX_TEXTURE_SIDE = 4096  # texels; larger images are reduced. Pictures are seldom larger, and OpenGL 4.3 promises 16384
PICTURE_FORMATS = ("PNG", "JPEG", "WEBP", "TGA", "BMP", "TIFF")  # Pillow knows forty more, some of which start other programs
BLOCK_ROWS = 64  # of 4096 texels of 4 channels: 8 MB as 64-bit numbers; any value in 8 .. 512 does
HALF_BYTES = 2
PIXEL_BYTES = 4 + 4 * HALF_BYTES  # while a texture is made
BLED_PIXEL_BYTES = 40  # the same with the float32 copies of `alpha_bled`
# Up to 4096 x 4096 always, since textures of one colour are stored in next to nothing; larger ones at 400 times their file.
TEXTURE_LIMITS = ImageLimits(free_bytes=2**28, ratio=400)
# Of a file's textures together: one of 4096 x 4096 with alpha, and 160 times what is stored: JPEG and WebP of photographs take a thirtieth
# to a hundredth of this.
FREE_TEXTURE_BYTES, TEXTURE_RATIO = 2**27, 160


class Texture(NamedTuple):
    """An image on a surface.

    texels: (h, w, c) float16, linear, the first row at the bottom. repeats: whether the image repeats across and up, or is clamped.
    filters: OpenGL's numbers, for minification and magnification. uv_set: which set of texture coordinates addresses it, 0 or 1.
    uv_transform: (2, 3) float64, from those coordinates, v upwards, to the image's; None: identity.
    """

    texels: np.ndarray
    repeats: tuple[bool, bool] = (True, True)
    filters: tuple[int, int] = (LINEAR_MIPMAP_LINEAR, LINEAR)
    uv_set: int = 0
    uv_transform: np.ndarray | None = None


def open_picture(content: bytes, where: Path | str, pixel_bytes: int = PIXEL_BYTES) -> Image.Image:
    """An image whose header has been read and found to be within TEXTURE_LIMITS; where: begins the UserError of one that is not.

    Raises OSError, ValueError or SyntaxError for what Pillow cannot read.
    """
    with silent():
        image = Image.open(io.BytesIO(content), formats=PICTURE_FORMATS)
    TEXTURE_LIMITS.check(where, *image.size, len(content), pixel_bytes)
    return image


def texels_from_image(image: Image.Image, srgb: bool = True, alpha: bool = False) -> np.ndarray:
    """An image's texels, (h, w, 3) float16 or, with `alpha`, (h, w, 4), the first row at the bottom as OpenGL has it.

    srgb: whether its colours are sRGB-coded, to be made linear; alpha never is. A side longer than MAX_TEXTURE_SIDE is reduced to it.
    """
    with silent():
        mode = "RGBA" if alpha else "RGB"
        image = image if image.mode == mode else image.convert(mode)
    if max(image.size) > MAX_TEXTURE_SIDE:
        image.thumbnail((MAX_TEXTURE_SIDE, MAX_TEXTURE_SIDE))
    codes, fractions = np.asarray(image)[::-1], (np.arange(256) / 255).astype(np.float16)
    colours = linear_from_srgb(np.arange(256) / 255).astype(np.float16) if srgb else fractions
    found = np.empty(codes.shape, np.float16)
    for rows in row_blocks(codes):  # numpy looks up by 64-bit numbers
        found[rows] = colours[codes[rows]]
        if alpha:
            found[rows, :, 3] = fractions[codes[rows, :, 3]]
    return found


def row_blocks(image: np.ndarray) -> list[slice]:
    """The rows of an image in blocks, for what takes many bytes a texel meanwhile."""
    return [slice(row, row + BLOCK_ROWS) for row in range(0, len(image), BLOCK_ROWS)]


def alpha_bled(image: np.ndarray) -> np.ndarray:
    """The image (h, w, 4) float16 with the colours of its visible texels spread into those of alpha 0 (alpha bleeding).

    Filters then mix in no colour that the image hides. Pull and push (Gortler et al. 1996): means over halved images, weighted with
    alpha, fill the finer ones. Returns the image itself where all of its texels are visible, or none.
    """
    import cv2  # here, since it takes a tenth of a second to load

    visible = image[..., 3] > 0
    if visible.all() or not visible.any():
        return image
    premultiplied = image.astype(np.float32)
    premultiplied[..., :3] *= premultiplied[..., 3:]
    pulled: list[np.ndarray] = [premultiplied]
    while max(pulled[-1].shape[:2]) > 1:
        height, width = pulled[-1].shape[:2]
        pulled.append(np.asarray(cv2.resize(pulled[-1], ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)))
    colours: np.ndarray = np.zeros((1, 1, 3), np.float32)
    for level in reversed(pulled[1:]):
        colours = np.array(cv2.resize(colours, level.shape[1::-1], interpolation=cv2.INTER_LINEAR))
        np.divide(level[..., :3], level[..., 3:], out=colours, where=level[..., 3:] > 0)
    filled = image.copy()
    filled[~visible, :3] = np.asarray(cv2.resize(colours, visible.shape[::-1], interpolation=cv2.INTER_LINEAR))[~visible]
    return filled
