"""Measured ray sets in the IES TM-25 format (IES TM-25-13, Ray File Format for the Description of the Emission Property of Light Sources).

A header of fixed fields, nine texts in UTF-32, a spectrum where there is one, padding to a multiple of 32 bytes, and then the rays: float32
rows of position (mm), direction, and the flux and colour items that the header's flags promise.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from vemlight.errors import UserError
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.renderer.luminaire.measuring import Rays

HEADER = np.dtype([
    ("magic", "S4"), ("version", "<i4"), ("creation", "<i4"), ("luminous_flux", "<f4"), ("radiant_flux", "<f4"), ("rays", "<u8"),
    ("date", "S28"), ("start", "<i4"), ("spectral", "<i4"), ("wavelength", "<f4"), ("wavelength_low", "<f4"), ("wavelength_high", "<f4"),
    ("spectra", "<i4"), ("additional_items", "<i4"), ("additional_text", "<i4"), ("reserved", "S168"), ("flags", "<i4", 8),
])
TEXTS, TEXT_BYTES = 9, 4000  # name, manufacturer, ... of 1000 UTF-32 characters each
# Items of a ray that stand before the luminous flux, by the flags' order: position, direction, radiant flux, wavelength, luminous flux,
# Stokes, tristimulus, spectrum index. In the rows: position, direction, radiant flux, Stokes 1 to 3, wavelength, luminous flux, X and Z,
# spectrum index, additional items.
POSITION, DIRECTION, RADIANT, WAVELENGTH, LUMINOUS, STOKES, TRISTIMULUS, SPECTRUM = range(8)
MAX_RAYS = 2**28  # 7.5 GB; the largest published sets hold 10^8


class RayFile(NamedTuple):
    """rays: in the file's own frame, metres, flux in lm (W when the file has radiant flux alone). header_flux: what the header claims."""

    rays: Rays
    photometric: bool
    header_flux: float
    name: str


def read_rays(path: Path) -> RayFile:
    """The rays of a TM-25 file. Raises UserError for a file that is missing, cut off, of another kind, or holds values no ray can have."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    if len(data) < HEADER.itemsize or data[:4] != b"TM25":
        raise UserError(f"{path}: is no IES TM-25 ray file (it does not begin with TM25); export it as TM-25")
    header = np.frombuffer(data, HEADER, 1)[0]
    flags = header["flags"]
    count, additional = int(header["rays"]), int(header["additional_items"])
    if not (flags[POSITION] and flags[DIRECTION] and (flags[RADIANT] or flags[LUMINOUS])):
        raise UserError(f"{path}: its rays lack position, direction or flux; export it with all three")
    if not (0 < count <= MAX_RAYS and 0 <= additional < 1000):
        raise UserError(f"{path}: its header claims {count} rays with {additional} additional items; copy it again")
    before = 6 + (1 if flags[RADIANT] else 0) + (3 if flags[STOKES] else 0) + (1 if flags[WAVELENGTH] else 0)
    items = before + (1 if flags[LUMINOUS] else 0) + (2 if flags[TRISTIMULUS] else 0) + (1 if flags[SPECTRUM] else 0) + additional
    start = len(data) - count * items * 4
    if start < HEADER.itemsize:
        raise UserError(f"{path}: holds {len(data)} bytes and {count} rays of {items} numbers need more; it was cut off, copy it again")
    rows = np.frombuffer(data, "<f4", count * items, start).reshape(count, items)
    column, claimed = (before, header["luminous_flux"]) if flags[LUMINOUS] else (6, header["radiant_flux"])
    lengths = np.linalg.norm(rows[:, 3:6].astype(np.float64), axis=1)
    power = rows[:, column].astype(np.float64)
    if not (np.all(np.isfinite(rows[:, :6])) and np.all(np.isfinite(power)) and np.all(np.abs(lengths - 1) < 1e-3) and power.min() >= 0):
        raise UserError(f"{path}: has rays with nan, negative flux or directions that are no unit vectors; copy it again")
    colour = _colour(data, header) if header["spectra"] == 1 else np.ones(3)
    rays = Rays(rows[:, :3] * 1e-3, rows[:, 3:6] / lengths[:, None], power[:, None] * colour)
    text = data[HEADER.itemsize : HEADER.itemsize + TEXT_BYTES].decode("utf-32-le", "replace").split("\0")[0].strip()
    return RayFile(rays, bool(flags[LUMINOUS]), float(claimed), text or path.stem)


def _colour(data: bytes, header: np.void) -> np.ndarray:
    """Rec. 709 colour of luminance 1 of the file's one spectrum: n pairs of wavelength in nm and weight, after the texts."""
    start = HEADER.itemsize + TEXTS * TEXT_BYTES + int(header["additional_text"]) * 4
    if len(data) < start + 4:
        return np.ones(3)
    n = int(np.frombuffer(data, "<i4", 1, start)[0])
    if not 0 < n <= 10_000 or len(data) < start + 4 + 8 * n:
        return np.ones(3)
    wavelength, weight = np.frombuffer(data, "<f4", 2 * n, start + 4).reshape(n, 2).T.astype(np.float64)
    return colour_of_spectrum(wavelength, weight)


def colour_of_spectrum(wavelength_nm: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Linear Rec. 709 colour (3,) of luminance 1; what lies outside the gamut is brought to its edge, white for a spectrum without light.

    CIE 1931 functions by Wyman, Sloan and Shirley 2013, Simple Analytic Approximations to the CIE XYZ Color Matching Functions.
    """
    def lobe(peak: float, below: float, above: float) -> np.ndarray:
        return np.exp(-0.5 * ((wavelength_nm - peak) * np.where(wavelength_nm < peak, below, above)) ** 2)

    x = 1.056 * lobe(599.8, 0.0264, 0.0323) + 0.362 * lobe(442.0, 0.0624, 0.0374) - 0.065 * lobe(501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    rgb_from_xyz = np.array([[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]])
    xyz = np.array([np.sum(weight * f) for f in (x, y, z)])
    if not (np.all(np.isfinite(xyz)) and xyz[1] > 0):
        return np.ones(3)
    rgb = np.maximum(rgb_from_xyz @ xyz, 0)
    return rgb / (rgb @ LUMINANCE_WEIGHTS)
