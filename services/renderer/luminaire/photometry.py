"""Far-field photometry: EULUMDAT (.ldt) and IES LM-63 (.ies) files as intensity over direction.

A lamp seen from afar is a point with an intensity, an approximation for distances over five times its largest dimension (Ashdown 1995).
In the luminaire's frame light travels towards +z: gamma is the angle from +z (the photometric nadir), C the angle from +x towards +y.
"""

import codecs
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vemlight.errors import UserError
from vemlight.files import read_file

PHOTOMETRY_SUFFIXES = (".ldt", ".ies")
FAR_FIELD_SIZES = 5.0  # times the largest dimension of the lamp: the rule of five
MAX_ANGLES = 2000  # of either kind: 0.18 degrees apart; a corrupt file claims more
MAX_BYTES = 2**22  # 721 x 361 angles of 12 characters have 3 MB; the numbers take ten times as much in memory
MAX_LAMP_SETS = 20  # the format has room for as many
MAX_CANDELA = 1e12  # a lighthouse has 10^7; products with it stay finite in float32
MAX_FLUX_LM = 1e9  # a stadium has 10^7


class FarField(NamedTuple):
    """candela: (planes, angles) float64 at c_deg (planes,), from 0 to 360 with both ends, and gamma_deg (angles,), within [0, 180].

    size_m: length, width, height of the luminous area. lamp_flux_lm: of the lamps as the file states it (nan when it does not).
    """

    candela: np.ndarray
    c_deg: np.ndarray
    gamma_deg: np.ndarray
    size_m: tuple[float, float, float]
    lamp_flux_lm: float
    name: str

    @property
    def valid_from_m(self) -> float:
        """The distance beyond which the lamp may be treated as a point."""
        return FAR_FIELD_SIZES * max(self.size_m)


def intensity(far: FarField, direction: np.ndarray) -> np.ndarray:
    """Candela (...) towards unit vectors (..., 3) in the luminaire's frame: bilinear in C and gamma, 0 outside the measured gammas."""
    from scipy.interpolate import RegularGridInterpolator

    gamma = np.degrees(np.arctan2(np.hypot(direction[..., 0], direction[..., 1]), direction[..., 2]))
    c = np.degrees(np.arctan2(direction[..., 1], direction[..., 0])) % 360
    table = RegularGridInterpolator((far.c_deg, far.gamma_deg), far.candela, bounds_error=False, fill_value=0.0)
    return table(np.stack([c, gamma], axis=-1))


def total_flux_lm(far: FarField) -> float:
    """Integral of the bilinear intensity over the sphere, lm: exact in C, and in gamma as the integral of a linear function times sin."""
    gamma, c = np.radians(far.gamma_deg), np.radians(far.c_deg)
    ring = np.trapezoid(far.candela, c, axis=0)
    step = np.diff(gamma)
    slope = np.diff(ring) / step
    # integral of (r + slope (g - g0)) sin g: by parts
    integral = ring[:-1] * np.cos(gamma[:-1]) - ring[1:] * np.cos(gamma[1:]) + slope * (np.sin(gamma[1:]) - np.sin(gamma[:-1]))
    return float(integral.sum())


def read_photometry(path: Path) -> FarField:
    """The far field in a .ldt or .ies file. Raises UserError, naming file and fault, for anything else."""
    text = read_file(path, MAX_BYTES).removeprefix(codecs.BOM_UTF8).decode("latin-1")
    readers = {".ldt": _read_eulumdat, ".ies": _read_lm63}
    if path.suffix.lower() not in readers:
        raise UserError(f"{path}: photometry is read from .ldt and .ies; convert it")
    try:
        with np.errstate(all="ignore"):  # of numbers so large that what they make is inf or nan
            far = readers[path.suffix.lower()](text)
    except (ValueError, IndexError, OverflowError) as error:
        raise UserError(f"{path}: is no valid photometry ({' '.join(str(error).split())[:120]}); export it again") from error
    if not (far.candela.min() >= 0 and far.candela.max() <= MAX_CANDELA and np.all(np.isfinite(far.size_m))):
        raise UserError(f"{path}: has intensities or dimensions that are negative, nan, inf or above {MAX_CANDELA:.0e} cd; export it again")
    return far._replace(name=far.name or path.stem)


def _read_eulumdat(text: str) -> FarField:
    """EULUMDAT (Stockmar 1990): a fixed order of lines; symmetries 0 none, 1 about the axis, 2 C0-C180, 3 C90-C270, 4 both."""
    lines = [line.strip() for line in text.splitlines()]

    def number(k: int) -> float:
        return float(lines[k].replace(",", "."))

    symmetry, planes, angles = int(number(2)), int(number(3)), int(number(5))
    if not (0 <= symmetry <= 4 and 1 <= planes <= MAX_ANGLES and 2 <= angles <= MAX_ANGLES):
        raise ValueError(f"symmetry {symmetry}, {planes} C planes and {angles} angles in lines 3, 4 and 6")
    length, width, height = (number(k) * 1e-3 for k in (12, 13, 14))
    luminous_length, luminous_width, luminous_heights = number(15) * 1e-3, number(16) * 1e-3, [number(k) * 1e-3 for k in (17, 18, 19, 20)]
    sets = int(number(25))
    if not 1 <= sets <= MAX_LAMP_SETS:
        raise ValueError(f"{sets} sets of lamps in line 26")
    flux = sum(abs(number(28 + 6 * k)) for k in range(sets))
    if not 0 < flux < MAX_FLUX_LM:
        raise ValueError(f"a flux of {flux:g} lm in line 29")
    first_angle = 26 + 6 * sets + 10  # after the ten direct ratios
    values = np.array([number(k) for k in range(first_angle, first_angle + planes + angles)])
    stored = {0: planes, 1: 1, 2: planes // 2 + 1, 3: planes // 2 + 1, 4: planes // 4 + 1}[symmetry]
    start = first_angle + planes + angles
    table = np.array([number(k) for k in range(start, start + stored * angles)]).reshape(stored, angles)
    # dimensions: the luminous area, or the housing where the file gives none; a width of 0 means round
    sizes = (luminous_length or length, luminous_width or width, max(luminous_heights) or height)
    c, table = _full_circle(values[:planes], table, symmetry)
    scale = number(23)  # conversion factor for luminous intensities
    return FarField(table * (flux / 1000 * scale), c, values[planes:], sizes, flux, lines[8])


def _full_circle(c_deg: np.ndarray, table: np.ndarray, symmetry: int) -> tuple[np.ndarray, np.ndarray]:
    """C angles from 0 to 360 with both ends, and their rows, from the planes that EULUMDAT stores."""
    if symmetry == 1:
        return np.array([0.0, 360.0]), np.vstack([table, table])
    if symmetry == 3:  # stored from C90 by C180 to C270
        first = len(c_deg) // 4
        stored = c_deg[first : first + len(table)]
        rows = {round(c, 6): row for c, row in zip(stored, table, strict=True)}
        rows |= {round((180 - c) % 360, 6): row for c, row in zip(stored, table, strict=True)}
    else:
        stored = c_deg[: len(table)]
        rows = {round(c, 6): row for c, row in zip(stored, table, strict=True)}
        if symmetry == 4:
            rows |= {round(180 - c, 6): row for c, row in list(rows.items())}
        if symmetry in (2, 4):
            rows |= {round((360 - c) % 360, 6): row for c, row in list(rows.items())}
    rows[360.0] = rows[min(rows)]
    order = sorted(rows)
    if order[0] != 0 or len(order) < 3:
        raise ValueError(f"C planes begin at {order[0]:g} degrees")
    return np.array(order), np.array([rows[c] for c in order])


def _read_lm63(text: str) -> FarField:
    """IES LM-63-1986 to 2002, type C: keywords, TILT, then numbers. Feet and metres."""
    head, found, rest = text.partition("TILT=")
    if not found:
        raise ValueError("there is no TILT line")
    tilt, _, rest = rest.partition("\n")
    if tilt.strip() not in ("NONE", "INCLUDE"):
        raise ValueError(f"TILT={tilt.strip()[:20]} is neither NONE nor INCLUDE")
    numbers = [float(word) for word in rest.replace(",", " ").split()]
    if tilt.strip() == "INCLUDE":
        numbers = numbers[2 + 2 * int(numbers[1]) :]
    lamps, lumens, multiplier, vertical, horizontal, kind, units, width, length, height = numbers[:10]
    ballast, use = numbers[10], numbers[11]
    n, m = int(vertical), int(horizontal)
    if not (2 <= n <= MAX_ANGLES and 1 <= m <= MAX_ANGLES and len(numbers) >= 13 + n + m + n * m):
        raise ValueError(f"{m} x {n} angles are promised and {len(numbers)} numbers are there")
    if int(kind) != 1:
        raise ValueError("photometry of type A or B, and type C is read")
    gamma, c = np.array(numbers[13 : 13 + n]), np.array(numbers[13 + n : 13 + n + m])
    table = np.array(numbers[13 + n + m : 13 + n + m + n * m]).reshape(m, n) * (multiplier * ballast * use)
    if np.any(np.diff(gamma) <= 0) or np.any(np.diff(c) <= 0):
        raise ValueError("angles do not rise")
    c, table = _full_circle_lm63(c, table)
    metre = 0.3048 if int(units) == 1 else 1.0
    name = next((line.partition("]")[2].strip() for line in head.splitlines() if line.startswith("[LUMCAT]")), "")
    flux = lamps * lumens if lumens > 0 else np.nan  # -1: absolute photometry
    return FarField(table, c, gamma, (abs(length) * metre, abs(width) * metre, abs(height) * metre), flux, name)


def _full_circle_lm63(c_deg: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """LM-63's rule: the last angle gives the symmetry: 0 about the axis, 90 both planes, 180 one plane, 360 none; 90 to 270 the other."""
    if len(c_deg) == 1:
        return np.array([0.0, 360.0]), np.vstack([table, table])
    rows = {round(float(c), 6): row for c, row in zip(c_deg, table, strict=True)}
    if c_deg[0] == 90:
        rows |= {round((180 - c) % 360, 6): row for c, row in list(rows.items())}
    elif c_deg[-1] == 90:
        rows |= {round(180 - c, 6): row for c, row in list(rows.items())}
    if c_deg[-1] <= 180:
        rows |= {round((360 - c) % 360, 6): row for c, row in list(rows.items())}
    if 0.0 not in rows:
        raise ValueError(f"horizontal angles from {c_deg[0]:g} to {c_deg[-1]:g} close no circle")
    rows[360.0] = rows[0.0]
    order = sorted(rows)
    return np.array(order), np.array([rows[c] for c in order])
