"""The drawing of several renderers, viewers and mirrors on one sampler: python -m bench.wiring_drawing [--out docs/pictures/wiring.png]

Which processes a run has, and who takes whose frames, is taken from the settings that docs/several-cameras.md shows, so that the drawing
shows what `vemlight run` starts.
"""

import argparse
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import tomli_w
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from vemlight.runtime.channels import Instance, service_of
from vemlight.runtime.instances import instance_of, instances, producer, started, upstream
from vemlight.settings import Settings
from vemlight.settings_file import read_settings

CAMERAS = ("left", "right")
RUNS = {
    "studio": {"wire": {"renderers": ["renderer", "renderer.wall"]}},
    "wall": {"wire": {"names": {"renderer": "renderer.wall", "viewer": "viewer.wall"}, "elsewhere": ["capture", "fuse", "sampler"]}},
    "mirror": {"wire": {"names": {"viewer": "viewer.mirror"}, "elsewhere": ["capture", "fuse", "sampler", "renderer"]}},
}
COLUMN = {"capture": 0.0, "fuse": 1.25, "sampler": 2.5, "renderer": 3.85, "viewer": 5.2}
ROW = {"studio": 3.0, "wall": 2.0, "mirror": 1.0, "relay": 0.0}
COLOUR = {"studio": "#dbe9f6", "wall": "#e3f1dc", "mirror": "#f9ecd2", "relay": "#eee3f4"}
WIDTH, HEIGHT = 0.98, 0.34  # of a box, in columns and rows
FRAMES, POINTS, CONTROL = "#333333", "#b0422b", "#3a6ea5"

Places = dict[Instance, tuple[float, float]]


def read_runs(folder: Path) -> dict[str, Settings]:
    """The settings of each run, by name."""
    cameras = [{"name": name, "source": name, "at": [float(k), 0.0, 1.2]} for k, name in enumerate(CAMERAS)]
    (folder / "rig.toml").write_text(tomli_w.dumps({"camera": cameras}))
    read = {}
    for name, sections in RUNS.items():
        (folder / f"{name}.toml").write_text(tomli_w.dumps({"rig": {"file": "rig.toml"}, **sections}))
        read[name] = read_settings(folder / f"{name}.toml")
    return read


def places_of(runs: dict[str, Settings]) -> Places:
    """Where the box of each process is: in the row of the run that starts it."""
    places: Places = {}
    for run, settings in runs.items():
        for name in started(settings):
            column, row = COLUMN[service_of(name)], ROW[run]
            if service_of(name) == "capture":
                row += 0.3 - 0.6 * CAMERAS.index(name.partition(".")[2])
            places[name] = column, row
    return places


def box(axes: Axes, text: str, at: tuple[float, float]) -> None:
    x, y = at
    style = "round,pad=0.0,rounding_size=0.06"
    corner = (x - WIDTH / 2, y - HEIGHT / 2)
    axes.add_patch(FancyBboxPatch(corner, WIDTH, HEIGHT, boxstyle=style, facecolor="white", edgecolor="#555555", linewidth=0.9))
    axes.text(x, y, text, ha="center", va="center", fontsize=8.5, family="monospace")


def arrow(axes: Axes, begin: tuple[float, float], end: tuple[float, float], colour: str, style: str = "-", bend: float = 0.0) -> None:
    """From the right side of a box to the left side of another; of those that point back, from left to right."""
    side = WIDTH / 2 if end[0] > begin[0] else -WIDTH / 2
    shape = {"arrowstyle": "-|>", "color": colour, "linestyle": style, "connectionstyle": f"arc3,rad={bend}", "linewidth": 1.1}
    axes.annotate("", (end[0] - side, end[1]), (begin[0] + side, begin[1]), arrowprops={**shape, "shrinkA": 0, "shrinkB": 0})


def draw_run(axes: Axes, settings: Settings, places: Places) -> None:
    """The frames that the processes of a run take, and what its viewer controls."""
    here = started(settings)
    for name in here:
        service = service_of(name)
        if service in ("fuse", "sampler", "renderer"):
            for source in upstream(settings, service):
                arrow(axes, places[source], places[name], FRAMES)
        if service == "renderer":
            fuse = places[producer(settings, "points").instance]
            bend = -0.3 if fuse[1] == places[name][1] else 0.2
            arrow(axes, (fuse[0], fuse[1] - bend / 4), (places[name][0], places[name][1] - bend / 4), POINTS, "--", bend)
        if service == "viewer":
            picture = places[instance_of(settings, "renderer")]
            arrow(axes, picture, places[name], FRAMES)
            if instance_of(settings, "renderer") in here:
                (x, y), (px, py) = places[name], picture
                arrow(axes, (x, y - 0.1), (px, py - 0.1), CONTROL, ":")
            if instance_of(settings, "sampler") in here:
                (x, y), (sx, sy) = places[name], places[instance_of(settings, "sampler")]
                arrow(axes, (x + WIDTH / 2, y + HEIGHT / 2), (sx - WIDTH / 2, sy + HEIGHT / 2), CONTROL, ":", 0.12)


def draw(out: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        runs = read_runs(Path(folder))
        places = places_of(runs)
        assert set(places) == {name for settings in runs.values() for name in instances(settings)}, "one of them starts each"
        figure, axes = pyplot.subplots(figsize=(10.5, 4.6), dpi=150)
        for run, row in ROW.items():
            command = "vemlight relay sampler studio.toml --listen 0.0.0.0:5702" if run == "relay" else f"vemlight run {run}.toml"
            axes.axhspan(row - 0.46, row + 0.46, color=COLOUR[run], alpha=0.35, linewidth=0)
            axes.text(-0.5 if run != "studio" else 0.75, row + 0.37, command, fontsize=8, family="monospace", color="#555555", va="center")
        for settings in runs.values():
            draw_run(axes, settings, places)
        places["relay"] = COLUMN["renderer"], ROW["relay"]
        arrow(axes, places["sampler"], places["relay"], FRAMES)
        for k in range(5):
            arrow(axes, places["relay"], (COLUMN["viewer"], ROW["relay"] + 0.3 - 0.15 * k), FRAMES)
        axes.text(COLUMN["viewer"] - 0.42, ROW["relay"], "many listeners:\nother hosts, programs", fontsize=8, va="center")
        for name, at in places.items():
            box(axes, name, at)
        for colour, style, text, x in (
            (FRAMES, "-", "frames: maps, lights, pictures", -0.45), (POINTS, "--", "near lights, on the same stamp", 1.7),
            (CONTROL, ":", "what the person at the page chooses", 3.75),
        ):  # fmt: skip
            axes.plot([x, x + 0.25], [-0.72, -0.72], color=colour, linestyle=style, linewidth=1.2)
            axes.text(x + 0.3, -0.72, text, fontsize=8, va="center")
        axes.set_xlim(-0.6, 5.95)
        axes.set_ylim(-0.85, 3.55)
        axes.axis("off")
        figure.subplots_adjust(0, 0, 1, 1)
        figure.savefig(out)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/pictures/wiring.png"))
    draw(parser.parse_args().out)


if __name__ == "__main__":
    main()
