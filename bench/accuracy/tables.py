"""The tables of docs/accuracy.md, from the charts' numbers: each stands between <!-- NAME --> and <!-- end -->."""

import csv
import re
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.progress import Progress

from bench.methods import POINTS, SOFT
from vemlight.files import written_whole

PAGE = Path(__file__).parents[2] / "docs" / "accuracy.md"
SHOWN = (16, 64, 256, 1024)
Rows = list[dict[str, str]]


def tables(out: Path, progress: Progress) -> None:
    """Writes the page's tables anew from the CSVs in `out`."""
    made = {
        "still": _still,
        "maps": _maps,
        "moving": _moving,
        "targets": _targets,
        "requirement": _requirement,
        "times": _times,
        "frame_times": _frame_times,
    }
    page = PAGE.read_text()
    for name, table in progress.track(made.items(), description="tables"):
        text = _markdown(table(out))
        page, found = re.subn(rf"(<!-- {name} -->\n).*?(?=<!-- end -->)", lambda match, text=text: match[1] + text, page, flags=re.DOTALL)
        assert found == 1, f"{PAGE}: no place for the table {name}"
    with written_whole(PAGE) as part:
        part.write_text(page)


def _read(out: Path, name: str) -> Rows:
    with open(out / f"accuracy_{name}.csv", newline="") as file:
        return list(csv.DictReader(file))


def _markdown(lines: list[list[str]]) -> str:
    head, *rest = (f"| {' | '.join(line)} |\n" for line in lines)
    return head + "|" + "---|" * len(lines[0]) + "\n" + "".join(rest)


def _mean(rows: Rows, key: str, **where: Any) -> float:
    return float(np.mean([float(row[key]) for row in rows if all(row[k] == str(v) for k, v in where.items())] or [np.nan]))


def _short(value: float, digits: int = 3) -> str:
    return "" if np.isnan(value) else f"{value:.{digits}f}".removeprefix("0")


def _two(value: float) -> str:
    """With two significant digits."""
    return f"{float(f'{value:.2g}'):g}"


def _still(out: Path) -> list[list[str]]:
    rows = _read(out, "still_lights")
    lines = [["", *(f"{count} lights" for count in SHOWN), "ms at 64"]]
    for method in dict.fromkeys(row["method"] for row in rows):
        errors = [_short(_mean(rows, "error_hard", method=method, asked=count), 4) for count in SHOWN]
        lines.append([method, *errors, _two(_mean(rows, "ms", method=method, asked=64))])
    return lines


def _maps(out: Path) -> list[list[str]]:
    rows, counts = _read(out, "still_maps"), (8, 16, 64, 256)
    with open(out / "soft_bound.csv", newline="") as file:
        bound = list(csv.DictReader(file))
    names = [f"points, {counts[0]} lights", *map(str, counts[1:]), "64 in RGB", f"soft, {counts[0]}", *map(str, counts[1:]), "64 in RGB"]
    lines = [["", *names, f"best soft found, {counts[0]}", *map(str, counts[1:])]]
    for name in [*dict.fromkeys(row["map"] for row in rows), None]:
        where, errors = {"map": name} if name else {}, []
        for method in (POINTS, SOFT):
            errors += [_mean(rows, "error_hard", method=method, asked=count, **where) for count in counts]
            errors.append(_mean(rows, "error_rgb", method=method, asked=64, **where))
        errors += [_mean(bound, "bound", lights=count, **where) for count in counts]
        lines.append([name or "**mean**", *(_short(value, 4) for value in errors)])
    return [*lines, ["target", "", ".08", ".03", ".012", ".035", ".050", ".025", ".0095", ".0050", ".0105", "", "", "", ""]]


def _moving(out: Path) -> list[list[str]]:
    rows = _read(out, "moving_flicker")
    sequences = list(dict.fromkeys(row["sequence"] for row in rows))
    lines = [["error / flicker", *sequences]]
    for method in dict.fromkeys(row["method"] for row in rows):
        pairs = [[_mean(rows, key, method=method, sequence=name) for key in ("error", "flicker")] for name in sequences]
        lines.append([method, *(f"{_short(error)} / {_short(flicker, 4)}" for error, flicker in pairs)])
    return lines


def _targets(out: Path) -> list[list[str]]:
    """The targets of the default method, and what it reaches."""
    rows = _read(out, "moving_flicker")

    def measured(sequence: str, key: str) -> float:
        return _mean(rows, key, method=SOFT, sequence=sequence)

    lines = [["sequence", "target", "measured"]]
    limits = ("rotation", None, ".02"), ("hand-held", ".035", ".02"), ("zenith", ".03", ".02"), ("seam", ".03", ".02")
    for name, error, flicker in limits:
        target = [f"error {error}"] * bool(error) + [f"flicker {flicker}"]
        reached = [f"error {_short(measured(name, 'error'))}, flicker {_short(measured(name, 'flicker'), 4)}"]
        if name == "hand-held":
            target, reached = [*target, "under one jumping light a frame"], [*reached, f"{measured(name, 'jumps'):.2f} jumping lights"]
        lines.append([name, ", ".join(target), ", ".join(reached)])
    for name, worst in (("lamp", ".05"), ("damaged frames", ".05"), ("black frames", ".05"), ("lost frames", "")):
        lines.append([name, f"worst frame {worst}" if worst else "", f"worst frame {_short(measured(name, 'error_worst'))}"])
    mains = [f"{_short(measured(f'mains {fps} fps', 'flicker'), 4)}" for fps in (21, 25, 30)]
    lines.append(["mains, 21, 25, 30 fps", "residual flicker .03", ", ".join(mains)])
    still = [row for row in rows if row["sequence"] in ("zenith", "seam", "lamp") and row["method"] == "tracked, points, nothing smoothed"]
    return [*lines, ["power", "exact to 1e-4", f"{max(float(row['power_worst']) for row in still):.0e} where nothing is smoothed"]]


def _requirement(out: Path) -> list[list[str]]:
    rows = _read(out, "requirement")
    methods = list(dict.fromkeys(row["method"] for row in rows))
    lines = [["error limit", *(f"{method}: {what}" for method in methods for what in ("lights", "within", "mean", "worst"))]]
    for limit in dict.fromkeys(row["limit"] for row in rows):
        line = [f"{100 * float(limit):g} %"]
        for method in methods:
            own = [row for row in rows if row["method"] == method and row["limit"] == limit]
            errors = [100 * float(row["error"]) for row in own]
            within = sum(value <= 100 * float(limit) for value in errors)
            lights = median(int(row["lights"]) for row in own)
            line += [f"{lights}", f"{within} of {len(errors)}", f"{np.mean(errors):.1f} %", f"{max(errors):.1f} %"]
        lines.append(line)
    return lines


def _times(out: Path) -> list[list[str]]:
    rows = _read(out, "times")
    return [["ms", "the paper, 3 GHz Pentium 4", "here"], *([r["part"], r["paper_ms"], _two(float(r["ours_ms"]))] for r in rows)]


def _frame_times(out: Path) -> list[list[str]]:
    """Over the maps: the median one, the slowest one, and the slowest frame of any."""
    rows = _read(out, "frame_times")
    counts = list(dict.fromkeys(row["lights"] for row in rows))
    lines = [["ms a frame", *(f"{count} lights: {what}" for count in counts for what in ("median map", "slowest map", "slowest frame"))]]
    for name in dict.fromkeys(row["sequence"] for row in rows):
        line = [name]
        for count in counts:
            own = [row for row in rows if row["sequence"] == name and row["lights"] == count]
            ms = [float(row["ms"]) for row in own]
            slowest = own[int(np.argmax(ms))]["map"]
            line += [_two(median(ms)), f"{_two(max(ms))} ({slowest})", _two(max(float(row["worst_ms"]) for row in own))]
        lines.append(line)
    return lines
