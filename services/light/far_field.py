"""The far field of a lamp: its intensity over direction.

A lamp seen from afar is a point with an intensity, an approximation for distances over five times its largest dimension (Ashdown 1995).
In the luminaire's frame light travels towards +z: gamma is the angle from +z (the photometric nadir), C the angle from +x towards +y.
"""

from typing import NamedTuple

import numpy as np

FAR_FIELD_SIZES = 5.0  # times the largest dimension of the lamp: the rule of five
MAX_ANGLES = 2000  # of either kind: 0.18 degrees apart; a corrupt file claims more


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


def number_from_text(text: str) -> float:
    """A decimal number as photometric files write it. Raises ValueError for anything else, such as nan or 1_000."""
    number = float(text)
    if not np.isfinite(number) or "_" in text:
        raise ValueError(f"{text[:40]!r} is no number")
    return number


def check_rising(degrees: np.ndarray, name: str, last: float) -> None:
    """Raises ValueError unless angles rise, within [0, last]."""
    if np.any(np.diff(degrees) <= 0):
        raise ValueError(f"its {name} angles do not rise")
    if degrees[0] < 0 or degrees[-1] > last:
        raise ValueError(f"its {name} angles go from {degrees[0]:g} to {degrees[-1]:g}, outside 0 to {last:g}")
