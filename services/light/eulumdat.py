"""EULUMDAT files (.ldt): photometry as lines in a fixed order (Stockmar 1990, "EULUMDAT, ein Leuchtendatenformat fuer den europaeischen
Beleuchtungsplaner").
"""

import numpy as np

from vemlight.light.far_field import MAX_ANGLES, FarField, check_rising, number_from_text

MAX_LAMP_SETS = 20  # the format has room for as many
MAX_FLUX_LM = 1e9  # a stadium has 10^7
SET_LINES = 6  # of a lamp set: number, type, flux, colour, rendering, watts
RATIO_LINES = 10  # direct ratios, behind the lamp sets


class _Lines:
    """The lines of a file, by their numbers in the format's description, which counts from 1."""

    def __init__(self, text: str) -> None:
        self.texts = [line.strip() for line in text.split("\n")]

    def text(self, line: int) -> str:
        """Raises ValueError where the file ends before."""
        if line > len(self.texts):
            raise ValueError(f"it ends at line {len(self.texts)} of {line} or more: cut off")
        return self.texts[line - 1]

    def number(self, line: int, blank: float | None = None) -> float:
        """The number in a line; blank: what it is where nothing is written. Raises ValueError that names the line."""
        text = self.text(line)
        if not text and blank is not None:
            return blank
        try:
            return number_from_text(text.replace(",", "."))
        except ValueError as error:
            raise ValueError(f"line {line}: {text[:40]!r} is no number") from error

    def numbers(self, first: int, count: int) -> np.ndarray:
        """The numbers of `count` lines."""
        self.text(first + count - 1)
        return np.array([self.number(line) for line in range(first, first + count)])

    def check_end(self, last: int) -> None:
        """Raises ValueError where numbers follow the last line that the header promises."""
        more = [text for text in self.texts[last:] if text]
        if more:
            raise ValueError(f"line {last + 1}: {more[0][:40]!r} and {len(more) - 1} more lines follow what its header promises")


def read_eulumdat(text: str, lamp_set: int) -> tuple[FarField, list[str]]:
    """The far field of a file's text, lines ended by \\n, with the lamps of set number `lamp_set`, from 1; 0: the first.

    Lamp sets are alternatives: intensities are told for 1000 lm of whichever is in use. Returns lines about what the user should know, too.
    Raises ValueError for what is no such file.
    """
    lines = _Lines(text)
    symmetry, planes, angles = (int(lines.number(line)) for line in (3, 4, 6))
    if not (0 <= symmetry <= 4 and 1 <= planes <= MAX_ANGLES and 2 <= angles <= MAX_ANGLES):
        raise ValueError(f"symmetry {symmetry}, {planes} C planes and {angles} angles in lines 3, 4 and 6")
    factor, tilt_deg = lines.number(24, blank=1.0), lines.number(25, blank=0.0)
    if not factor > 0:
        raise ValueError(f"line 24: a conversion factor of {factor:g}, which leaves no light")
    flux, sets = _lamp_flux(lines, lamp_set)
    notes = []
    if sets > 1 and not lamp_set:
        fluxes = ", ".join(f"{_flux_of_set(lines, k):g}" for k in range(1, sets + 1))
        notes.append(f"has {sets} alternative lamp sets ({fluxes} lm) and the first is taken; lamp_set = 2 in the scene takes the second")
    if tilt_deg:
        notes.append(f"was measured tilted by {tilt_deg:g} degrees, and is drawn as measured; rotate it in the scene")

    first = 27 + SET_LINES * sets + RATIO_LINES
    c, gamma = np.split(lines.numbers(first, planes + angles), [planes])
    stored = {0: planes, 1: 1, 2: planes // 2 + 1, 3: planes // 2 + 1, 4: planes // 4 + 1}[symmetry]
    start = first + planes + angles
    table = lines.numbers(start, stored * angles).reshape(stored, angles)
    lines.check_end(start + stored * angles - 1)
    check_rising(gamma, "gamma", 180)
    check_rising(c, "C", 360)
    c, table = _full_circle(c, table, symmetry)
    return FarField(table * (flux / 1000 * factor), c, gamma, _size_m(lines), flux, lines.text(9)), notes


def _lamp_flux(lines: _Lines, lamp_set: int) -> tuple[float, int]:
    """The flux of the lamp set in use, lm, and how many sets there are."""
    sets = int(lines.number(26, blank=1.0))
    if not 1 <= sets <= MAX_LAMP_SETS:
        raise ValueError(f"{sets} sets of lamps in line 26")
    if lamp_set > sets:
        raise ValueError(f"it has {sets} lamp set{'s' if sets > 1 else ''} and lamp_set asks for number {lamp_set}")
    flux = _flux_of_set(lines, max(lamp_set, 1))
    if not 0 < flux < MAX_FLUX_LM:
        raise ValueError(f"a flux of {flux:g} lm in line {29 + SET_LINES * (max(lamp_set, 1) - 1)}")
    return flux, sets


def _flux_of_set(lines: _Lines, lamp_set: int) -> float:
    return abs(lines.number(29 + SET_LINES * (lamp_set - 1)))


def _size_m(lines: _Lines) -> tuple[float, float, float]:
    """Length, width and height of the luminous area, or of the housing where the file gives no area.

    A width of 0 means round. An area whose heights are all 0 is flat.
    """
    housing, area = ([lines.number(line, blank=0.0) * 1e-3 for line in numbers] for numbers in ((13, 14, 15), (16, 17)))
    length, width, height = (*area, max(lines.number(line, blank=0.0) * 1e-3 for line in (18, 19, 20, 21))) if area[0] else housing
    return length, width or length, height


def _full_circle(c_deg: np.ndarray, table: np.ndarray, symmetry: int) -> tuple[np.ndarray, np.ndarray]:
    """C angles from 0 to 360 with both ends, and their rows, from the planes that are stored.

    Symmetry: 0 none, 1 about the axis, 2 about C0-C180, 3 about C90-C270, 4 about both. A single plane is symmetric about the axis. Raises
    ValueError where the planes of symmetry are none of the file's.
    """
    if symmetry == 1 or len(c_deg) == 1:
        return np.array([0.0, 360.0]), np.vstack([table[:1], table[:1]])
    planes = len(c_deg) - (c_deg[-1] == 360)
    # The format's Mc1 for symmetry 3 is 3 Mc / 4 + 1: from C270 by C0 to C90, where the light of an asymmetric lamp goes.
    first = 3 * planes // 4 if symmetry == 3 else 0
    angles = c_deg[(first + np.arange(len(table))) % planes if symmetry else np.arange(len(table))]
    if (ends := {2: (0, 180), 3: (270, 90), 4: (0, 90)}.get(symmetry)) and not np.allclose(angles[[0, -1]], ends):
        raise ValueError(f"its C planes have symmetry {symmetry} and are stored from {angles[0]:g} to {angles[-1]:g} degrees")
    rows = {round(c, 6): row for c, row in zip(angles.tolist(), table, strict=True)}
    if symmetry in (3, 4):
        rows |= {round((180 - c) % 360, 6): row for c, row in list(rows.items())}
    if symmetry in (2, 4):
        rows |= {round((360 - c) % 360, 6): row for c, row in list(rows.items())}
    rows[360.0] = rows[min(rows)]
    order = sorted(rows)
    if order[0] != 0 or len(order) < 3:
        raise ValueError(f"C planes begin at {order[0]:g} degrees")
    return np.array(order), np.array([rows[c] for c in order])
