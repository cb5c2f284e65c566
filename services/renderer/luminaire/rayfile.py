"""Measured ray sets in the IES TM-25 format (IES TM-25-13, Ray File Format for the Description of the Emission Property of Light Sources).

A header of fixed fields, nine texts in UTF-32, an optional spectrum, padding to a multiple of 32 bytes, and then the rays: float32 rows of
position (mm), direction, and the flux and colour items that the header's flags announce.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from vemlight.errors import UserError
from vemlight.files import read_file
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.renderer.luminaire.acquisition import Rays

TM25_HEADER = np.dtype([
    ("magic", "S4"), ("version", "<i4"), ("creation", "<i4"), ("luminous_flux", "<f4"), ("radiant_flux", "<f4"), ("rays", "<u8"),
    ("date", "S28"), ("start", "<i4"), ("spectral", "<i4"), ("wavelength", "<f4"), ("wavelength_low", "<f4"), ("wavelength_high", "<f4"),
    ("spectra", "<i4"), ("additional_items", "<i4"), ("additional_text", "<i4"), ("reserved", "S168"), ("flags", "<i4", 8),
])
TEXTS, TEXT_BYTES = 9, 4000  # name, manufacturer, ... of 1000 UTF-32 characters each
POSITION, DIRECTION, RADIANT, WAVELENGTH, LUMINOUS, STOKES, TRISTIMULUS, SPECTRUM = range(8)  # the flags, in their order
# The items of a ray in the order of its row, with their number of floats; additional items follow.
ITEMS = ((POSITION, 3), (DIRECTION, 3), (RADIANT, 1), (STOKES, 3), (WAVELENGTH, 1), (LUMINOUS, 1), (TRISTIMULUS, 2), (SPECTRUM, 1))
MAX_RAYS = 2**28  # 7.5 GB; the largest published sets hold 10^8
MAX_BYTES = 2**33  # so many rays of 7 floats and their texts
MAX_ADDITIONAL_ITEMS = 1000  # of a ray; a corrupt header claims more
DIRECTION_TOLERANCE = 1e-3  # of a unit vector's length: writers round to three decimals and more
MAX_WAVELENGTHS = 10_000  # of a spectrum: 0.04 nm over the visible range; a corrupt file claims more


class RayFile(NamedTuple):
    """rays: in the file's own frame, metres, flux in lm (W when the file has radiant flux alone). header_flux: what the header claims."""

    rays: Rays
    photometric: bool
    header_flux: float
    name: str


def read_rays(path: Path) -> RayFile:
    """The rays of a TM-25 file. Raises UserError for a file that is missing, truncated, of another kind, or holds impossible values."""
    data = read_file(path, MAX_BYTES)
    if len(data) < TM25_HEADER.itemsize or data[:4] != b"TM25":
        raise UserError(f"{path}: is no IES TM-25 ray file (it does not begin with TM25); export it as TM-25")
    header = np.frombuffer(data, TM25_HEADER, 1)[0]
    flags = header["flags"]
    rows, columns = _rows(path, data, header)
    flux_item, header_flux = (LUMINOUS, header["luminous_flux"]) if flags[LUMINOUS] else (RADIANT, header["radiant_flux"])
    lengths = np.linalg.norm(rows[:, columns[DIRECTION] : columns[DIRECTION] + 3].astype(np.float64), axis=1)
    power = rows[:, columns[flux_item]].astype(np.float64)
    unit_length = np.all(np.abs(lengths - 1) < DIRECTION_TOLERANCE)
    if not (np.all(np.isfinite(rows[:, :6])) and np.all(np.isfinite(power)) and unit_length and power.min() >= 0):
        raise UserError(f"{path}: has rays with nan, negative flux or directions that are no unit vectors; copy it again")
    colour = _colour(data, header) if header["spectra"] == 1 else np.ones(3)
    rays = Rays(rows[:, :3] * 1e-3, rows[:, 3:6] / lengths[:, None], power[:, None] * colour)
    text = data[TM25_HEADER.itemsize : TM25_HEADER.itemsize + TEXT_BYTES].decode("utf-32-le", "replace").split("\0")[0].strip()
    return RayFile(rays, bool(flags[LUMINOUS]), float(header_flux), text or path.stem)


def _rows(path: Path, data: bytes, header: np.void) -> tuple[np.ndarray, dict[int, int]]:
    """The rays' numbers (count, items) float32 at the end of a file, and the first column of each item that they have."""
    flags, count, additional = header["flags"], int(header["rays"]), int(header["additional_items"])
    if not (flags[POSITION] and flags[DIRECTION] and (flags[RADIANT] or flags[LUMINOUS])):
        raise UserError(f"{path}: its rays lack position, direction or flux; export it with all three")
    if not (0 < count <= MAX_RAYS and 0 <= additional < MAX_ADDITIONAL_ITEMS):
        raise UserError(f"{path}: its header claims {count} rays with {additional} additional items; copy it again")
    columns, items = {}, 0
    for flag, size in ITEMS:
        if flags[flag]:
            columns[flag] = items
            items += size
    items += additional
    start = len(data) - count * items * 4
    if start < TM25_HEADER.itemsize:
        raise UserError(f"{path}: holds {len(data)} bytes and {count} rays of {items} numbers need more; it was cut off, copy it again")
    return np.frombuffer(data, "<f4", count * items, start).reshape(count, items), columns


def _colour(data: bytes, header: np.void) -> np.ndarray:
    """Rec. 709 colour of luminance 1 of the file's one spectrum: n pairs of wavelength in nm and weight, after the texts."""
    additional_text = int(header["additional_text"])
    start = TM25_HEADER.itemsize + TEXTS * TEXT_BYTES + additional_text * 4
    if additional_text < 0 or len(data) < start + 4:
        return np.ones(3)
    n = int(np.frombuffer(data, "<i4", 1, start)[0])
    if not 0 < n <= MAX_WAVELENGTHS or len(data) < start + 4 + 8 * n:
        return np.ones(3)
    wavelength, weight = np.frombuffer(data, "<f4", 2 * n, start + 4).reshape(n, 2).T.astype(np.float64)
    return colour_of_spectrum(wavelength, weight)


def colour_of_spectrum(wavelength_nm: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Linear Rec. 709 colour (3,) of luminance 1, clipped to the gamut; white for a spectrum without light.

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
