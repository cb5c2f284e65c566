"""What all charts of accuracy share: colours, a legend below, a caption with command and machine, files small enough for a repository."""

import csv
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from vemlight.commands.chart import machine
from vemlight.files import written_whole

matplotlib.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

COMMAND = "python -m bench.accuracy"
SHADES = 48  # colours of a picture in a chart: a third of the bytes, and no difference at this size
_COLOURS = plt.get_cmap("tab20").colors  # type: ignore[attr-defined]
plt.rcParams["svg.fonttype"] = "none"  # text as text


def colour(k: int) -> tuple[float, float, float]:
    """Of the k-th method: the strong half of the palette first."""
    return _COLOURS[2 * k % 20 + k // 10]


def grid(count: int, height: float) -> tuple[Figure, np.ndarray]:
    """A figure with `count` axes or a few more, three in a line, and room for a legend below."""
    figure, axes = plt.subplots(-(-count // 3), 3, figsize=(16, height * -(-count // 3)), layout="constrained")
    leave_margin(figure, 0.09)
    for axis in axes.ravel()[count:]:
        axis.set_axis_off()
    return figure, axes.ravel()[:count]


def leave_margin(figure: Figure, fraction: float) -> None:
    """Leaves this fraction of the height free below, for legend and caption."""
    figure.get_layout_engine().set(rect=(0, fraction, 1, 1 - fraction))  # type: ignore[union-attr]


def legend(figure: Figure, axis: Any) -> None:
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=8, bbox_to_anchor=(0.5, 0.015))


def few_shades(picture: np.ndarray, width: int) -> np.ndarray:
    """A picture (height, width, 3) in [0, 1] with so many pixels across and SHADES colours."""
    image = Image.fromarray((255 * picture).astype(np.uint8))
    if width < image.width:
        image = image.resize((width, width * image.height // image.width), Image.Resampling.BOX)
    image = image.quantize(SHADES, dither=Image.Dither.NONE)
    return np.asarray(image.convert("RGB"))


def save(figure: Figure, rows: Iterable[dict[str, Any]], out: Path, name: str, note: str, dpi: int = 85) -> None:
    """The chart as PNG and SVG with its caption, the rows as CSV: accuracy_NAME."""
    chart = name.split("_")[0]
    figure.text(0.01, 0.004, f"{note}   {COMMAND} {chart}   {machine()}, one thread", fontsize=7, color="0.35")
    out.mkdir(parents=True, exist_ok=True)
    with written_whole(out / f"accuracy_{name}.png") as part:
        figure.savefig(part, dpi=dpi)
    with written_whole(out / f"accuracy_{name}.svg") as part:
        figure.savefig(part, dpi=dpi, metadata={"Date": None})
        part.write_text(_slim(part.read_text()))
    plt.close(figure)
    write_table(rows, out, name)


def write_table(rows: Iterable[dict[str, Any]], out: Path, name: str) -> None:
    """The rows as accuracy_NAME.csv."""
    rows = list(rows)
    with written_whole(out / f"accuracy_{name}.csv") as part, open(part, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows({k: f"{v:.5g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)


def _slim(svg: str) -> str:
    """An SVG with paths to a tenth of a point, and each picture that stands there several times once."""
    svg = re.sub(r"(\d\.\d\d)\d+", r"\1", svg)
    svg = re.sub(r"'DejaVu Sans'[^;\"]*sans-serif", "'DejaVu Sans', sans-serif", re.sub(r"\n +", "\n", svg))
    svg = re.sub(r' d="([^"]*)"', lambda path: f' d="{_steps(path[1])}"', svg)
    seen: dict[str, str] = {}

    def once(match: re.Match[str]) -> str:
        attributes, data = match[1] + match[3], match[2]
        if data in seen:
            place = "".join(re.findall(r' (?:x|y|transform)="[^"]*"', attributes))
            return f'<use xlink:href="#{seen[data]}"{place}/>'
        seen[data] = f"picture{len(seen)}"
        return f'<defs><image id="{seen[data]}"{_without_place(attributes)} xlink:href="{data}"/></defs>' + once(match)

    return re.sub(r'<image([^>]*?) xlink:href="(data:[^"]*)"([^>]*?)/>', once, svg)


def _steps(path: str) -> str:
    """A path with numbers to a tenth, and lines as steps from point to point."""
    if not re.fullmatch(r"(\s*[ML] \S+ \S+)+\s*", path):
        return re.sub(r"(\d\.\d)\d+", r"\1", path)
    words, x0, y0 = [], 0, 0
    for kind, *place in re.findall(r"([ML]) (\S+) (\S+)", path):
        x, y = (round(10 * float(value)) for value in place)
        words.append(f"M{x / 10:g} {y / 10:g}l" if kind == "M" else f"{(x - x0) / 10:g} {(y - y0) / 10:g}")
        x0, y0 = x, y
    return " ".join(words).replace(" -", "-")


def _without_place(attributes: str) -> str:
    return re.sub(r' (?:id|x|y|transform)="[^"]*"', "", attributes)
