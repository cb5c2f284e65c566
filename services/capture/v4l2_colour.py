"""What a camera's driver says of its colours, in the names of our settings (Linux media documentation, "Colorspaces")."""

from typing import Any

from vemlight.light.colour_tags import ColourTags

SRGB, JPEG, RAW, DEFAULT = 8, 7, 11, 0
PRIMARIES = {1: "smpte170m", 3: "bt709", 6: "bt470bg", JPEG: "bt709", SRGB: "bt709", 10: "bt2020", 12: "p3dci"}  # by colorspace
TRANSFERS = {1: "bt709", 2: "srgb", 5: "linear", 7: "pq"}  # by xfer_func
MATRICES = {1: "bt601", 2: "bt709", 3: "bt601", 4: "bt709", 6: "bt2020"}  # by ycbcr_enc
RANGES = {1: "full", 2: "limited"}  # by quantization


def tags_from_driver(colorspace: int, ycbcr_enc: int, quantization: int, xfer_func: int) -> ColourTags:
    """What the driver states; None where it says "default"."""
    return ColourTags(
        None if not xfer_func else TRANSFERS.get(xfer_func, f"tag {xfer_func} (xfer_func of the driver)"),
        None if colorspace == DEFAULT else PRIMARIES.get(colorspace, f"tag {colorspace} (colorspace of the driver)"),
        None if not ycbcr_enc else MATRICES.get(ycbcr_enc, f"tag {ycbcr_enc} (ycbcr_enc of the driver)"),
        RANGES.get(quantization),
    )


def defaults_of_driver(colorspace: int, is_rgb: bool, is_jpeg: bool) -> ColourTags:
    """What "default" stands for (V4L2_MAP_XFER_FUNC_DEFAULT and its like); a colorspace of 0 counts as sRGB, which cameras mostly mean."""
    colorspace = colorspace or SRGB
    transfer = "srgb" if colorspace in (SRGB, JPEG) else "linear" if colorspace == RAW else "bt709"
    matrix = "bt709" if colorspace in (3, 12) else "bt2020" if colorspace == 10 else "bt601"
    return ColourTags(transfer, "bt709", matrix, "full" if is_rgb or is_jpeg or colorspace == JPEG else "limited")


def colour_of_format(pix: Any, is_rgb: bool, is_jpeg: bool) -> tuple[ColourTags, ColourTags]:
    """The tags of a v4l2_pix_format, or of its multi-planar form, and what holds where they say nothing."""
    numbers = [int(getattr(pix, name, 0)) for name in ("colorspace", "ycbcr_enc", "quantization", "xfer_func")]
    tags = tags_from_driver(*numbers)
    return tags._replace(matrix="rgb") if is_rgb else tags, defaults_of_driver(numbers[0], is_rgb, is_jpeg)
