"""IES LM-63 files (.ies): keywords, a TILT line, then numbers (ANSI/IES LM-63-1986, -1991, -1995, -2002, -2019)."""

import re

import numpy as np

from vemlight.light.far_field import MAX_ANGLES, FarField, check_rising, number_from_text

SAME_PLANE = 0.01  # of the largest intensity: between two measurements of one plane. 0.002 to 0.05 would do
FIXED_NUMBERS = 13  # from the lamps to the watts
METRES_BY_UNIT = {1: 0.3048, 2: 1.0}
TILT_LINE = re.compile(r"^[ \t]*TILT[ \t]*=[ \t]*(.*?)[ \t]*$", re.MULTILINE | re.IGNORECASE)
# In files of these the twelfth number multiplies the light: the ballast-lamp photometric factor. 1995 and 2002 keep it for future use,
# 2019 makes it a code of how the file came to be.
FACTOR_EDITIONS = re.compile(r"(?!IES)|IESNA:?\s*(LM-63-)?(19)?(86|91)\b", re.IGNORECASE)


def read_lm63(text: str) -> tuple[FarField, list[str]]:
    """The far field of a file's text, lines ended by \\n, of type C, and lines about what the user should know.

    Raises ValueError for what is no such file, or has more or fewer numbers than it promises.
    """
    found = TILT_LINE.search(text)
    if not found:
        raise ValueError("there is no TILT line")
    head, tilt = text[: found.start()].lstrip(), found[1].upper()
    if tilt not in ("NONE", "INCLUDE"):
        raise ValueError(f"TILT={found[1][:40]} is neither NONE nor INCLUDE; a tilt table in another file is not read")
    numbers = _numbers(text[found.end() :], tilt == "INCLUDE")
    lamps, lumens, multiplier, vertical, horizontal, kind, units, width, length, height, ballast, twelfth = numbers[: FIXED_NUMBERS - 1]
    n, m = int(vertical), int(horizontal)
    if int(kind) != 1:
        raise ValueError("photometry of type A or B, and type C is read")
    if int(units) not in METRES_BY_UNIT:
        raise ValueError(f"dimensions in unit {units:g}, which is neither 1 (feet) nor 2 (metres)")
    factor, notes = multiplier * ballast, []
    if FACTOR_EDITIONS.match(head):
        factor *= twelfth
    elif twelfth != 1 and "2019" not in head.partition("\n")[0]:
        notes.append(f"its number for future use is {twelfth:g}, which changes nothing")
    if tilt == "INCLUDE":
        notes.append("has a table of its light by tilt, which is not applied: it is drawn as measured")
    if not factor > 0:
        raise ValueError(f"a multiplier of {multiplier:g} and a ballast factor of {ballast:g}, which leave no light")

    gamma, c, table = np.split(numbers[FIXED_NUMBERS:], [n, n + m])
    check_rising(gamma, "vertical", 180)
    check_rising(c, "horizontal", 360)
    table = table.reshape(m, n) * factor
    if c[0] == 0 and c[-1] == 360 and np.abs(table[0] - table[-1]).max() > SAME_PLANE * table.max():
        notes.append("its planes at 0 and 360 degrees, which are one, differ: that at 0 is drawn")
    c, table = _full_circle(c, table)
    size = [side * METRES_BY_UNIT[int(units)] for side in _sides(length, width, height)]
    name = next((line.strip()[8:].strip() for line in head.split("\n") if line.strip().upper().startswith("[LUMCAT]")), "")
    flux = lamps * lumens if lumens > 0 else np.nan  # -1: absolute photometry
    return FarField(table, c, gamma, (size[0], size[1], size[2]), flux, name), notes


def _numbers(text: str, has_tilt_table: bool) -> np.ndarray:
    """The numbers behind the TILT line and its table, exactly as many as they promise.

    A comma separates numbers; where it makes more of them than promised it is the decimal sign of a file from a place that writes so.
    """
    counts = []
    for readable in (text.replace(",", " "), re.sub(r"(?<=\d),(?=\d)", ".", text).replace(",", " ")):
        numbers = [number_from_text(word) for word in readable.split()]
        if has_tilt_table:
            numbers = numbers[2 + 2 * int(numbers[1]) :]
        if len(numbers) < FIXED_NUMBERS:
            counts.append(f"{len(numbers)} of {FIXED_NUMBERS} numbers are there: cut off")
            continue
        n, m = int(numbers[3]), int(numbers[4])
        if not (2 <= n <= MAX_ANGLES and 1 <= m <= MAX_ANGLES):
            counts.append(f"{m} x {n} angles are promised")
            continue
        promised = FIXED_NUMBERS + n + m + n * m
        if len(numbers) == promised:
            return np.array(numbers)
        counts.append(f"{m} x {n} angles are promised, which take {promised} numbers, and {len(numbers)} are there")
    raise ValueError(counts[0])


def _sides(length: float, width: float, height: float) -> tuple[float, float, float]:
    """The luminous area's sides, 0 or above. A negative width alone is the diameter of a round one."""
    return abs(length) or (abs(width) if width < 0 else 0.0), abs(width), abs(height)


def _full_circle(c_deg: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rule of the format: the last angle gives the symmetry: 0 about the axis, 90 both planes, 180 one plane, 360 none; 90 to 270 the
    other plane. Angles that go farther than 180 without reaching 360 go all the way round.
    """
    if len(c_deg) == 1:
        return np.array([0.0, 360.0]), np.vstack([table, table])
    rows = {round(float(c), 6): row for c, row in zip(c_deg, table, strict=True)}
    first, last = float(c_deg[0]), float(c_deg[-1])
    if (first, last) == (90, 270):
        rows |= {round((180 - c) % 360, 6): row for c, row in list(rows.items())}
    elif first != 0 or (last <= 180 and last not in (90, 180)):
        raise ValueError(f"horizontal angles from {first:g} to {last:g} close no circle")
    elif last == 90:
        rows |= {round(180 - c, 6): row for c, row in list(rows.items())}
    if last <= 180:
        rows |= {round((360 - c) % 360, 6): row for c, row in list(rows.items())}
    rows[360.0] = rows[0.0]
    order = sorted(rows)
    return np.array(order), np.array([rows[c] for c in order])
