"""Signed RGBE: three signed fractions and a common exponent in four bytes (Granier et al. 2003, section 4.2 and appendix A).

The safe codec keeps zero exactly and has no nan; the paper's own, beside it, shows what it costs to follow the print. Both keep 7 bits
and a sign: adding up passes in this format loses small terms, so light is summed in float and encoded once at most.
"""

import numpy as np

STEPS = 254  # codes 1 to 255 for -1/2 to 1/2 with 128 for 0, so that zero is exact and signs are symmetric


def srgbe_from_rgb(rgb: np.ndarray) -> np.ndarray:
    """Bytes (..., 4) of colours (..., 3): nan becomes 0, what exceeds 2^126 saturates, all below 2^-126 is black (128, 128, 128, 0)."""
    clean = np.nan_to_num(np.asarray(rgb, np.float64), nan=0.0, posinf=2.0**126, neginf=-(2.0**126)).clip(-(2.0**126), 2.0**126)
    largest = np.abs(clean).max(axis=-1)
    dark = ~(largest >= 2.0**-126)
    e = np.clip(np.frexp(np.where(dark, 1.0, largest))[1] + 1, -125, 127)
    fraction = np.clip(np.ldexp(clean, -e[..., None]), -0.5, 0.5)
    code = np.concatenate([np.rint(fraction * STEPS) + 128, (e + 126)[..., None]], axis=-1)
    return np.where(dark[..., None], [128, 128, 128, 0], code).astype(np.uint8)


def rgb_from_srgbe(code: np.ndarray) -> np.ndarray:
    """Colours (..., 3) float32 of bytes (..., 4)."""
    fraction = (code[..., :3].astype(np.float64) - 128) / STEPS
    return np.ldexp(fraction, code[..., 3:].astype(np.int64) - 126).astype(np.float32)


def printed_srgbe_from_rgb(rgb: np.ndarray) -> np.ndarray:
    """The Cg code of the appendix, in float32, with the rounding of an 8-bit frame buffer: black and overflow are undefined in it."""
    rgb = np.asarray(rgb, np.float32)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        e = np.floor(np.log2(np.abs(rgb).max(axis=-1))) + np.float32(2)
        levels = np.concatenate([rgb * np.exp2(-e)[..., None] + np.float32(0.5), ((e + 126) / 255)[..., None]], axis=-1)
        return np.rint(np.clip(np.nan_to_num(levels, nan=0.0), 0, 1) * 255).astype(np.uint8)


def printed_rgb_from_srgbe(code: np.ndarray) -> np.ndarray:
    """The appendix' decompression, in float32."""
    level = code.astype(np.float32) / np.float32(255)
    with np.errstate(over="ignore"):
        return (level[..., :3] - np.float32(0.5)) * np.exp2(np.rint(level[..., 3:] * 255) - np.float32(126))
