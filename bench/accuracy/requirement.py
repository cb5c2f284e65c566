"""The number of lights that `error_percent` chooses, and the error that they have, beside the limit."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from rich.progress import Progress

from bench.accuracy.drawing import colour, leave_margin, save
from bench.accuracy.maps import maps
from bench.evaluation import judged_hard, points_of, probe_irradiance, read_source
from bench.methods import POINTS, SOFT
from vemlight.light.colour import luminance_from_rgb
from vemlight.sampler.hard_probes import DARK_PROBE
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler

LIMITS_PERCENT = (40.0, 30.0, 20.0, 15.0, 10.0, 7.0, 5.0, 3.0)
METHODS = {SOFT: True, POINTS: False, "havran-azimuth": False}  # soft or not
LINES = {SOFT: "o-", POINTS: "^--", "havran-azimuth": "x:"}
TICKS, TICK_LABELS = (0.03, 0.05, 0.1, 0.2, 0.4), ("3 %", "5 %", "10 %", "20 %", "40 %")
SETTLING_FRAMES = 2  # the number is chosen in the first


def requirement(out: Path, progress: Progress) -> None:
    """The number of lights that `error_percent` chooses, and their error on probes that the choice did not use."""
    rows, paths = [], maps()
    task = progress.add_task("required lights", total=len(paths) * len(LIMITS_PERCENT) * len(METHODS))
    for path in paths:
        source = read_source(path)
        truth = luminance_from_rgb(probe_irradiance(points_of(source), 1).hard)
        for method, soft in METHODS.items():
            for limit in LIMITS_PERCENT:
                chosen: Any = "havran-azimuth" if method == "havran-azimuth" else "tracked"
                settings = Sampler(method=chosen, filter="none", count=1024, error_percent=limit, soft=soft)
                state, lights, report = initial_state(), None, None
                for k in range(SETTLING_FRAMES):
                    state, lights, report = step(settings, state, SamplerInput(source.polar, "hemisphere", k / 25, source.bright_cells))
                assert lights is not None
                assert report is not None
                got = luminance_from_rgb(judged_hard(lights))
                error = float(np.sqrt(np.mean(((got - truth) / (truth + DARK_PROBE * truth.mean())) ** 2)))
                rows.append(
                    {
                        "map": path.stem,
                        "method": method,
                        "limit": limit / 100,
                        "lights": len(lights.ids),
                        "error": error,
                        "estimate": report.error,
                    }
                )
                progress.advance(task)
    figure, axes = plt.subplots(1, 4, figsize=(22, 5.6), layout="constrained")
    leave_margin(figure, 0.05)
    for axis, method in zip(axes, METHODS, strict=False):
        for k, path in enumerate(paths):
            own = [r for r in rows if r["map"] == path.stem and r["method"] == method]
            axis.loglog([r["limit"] for r in own], [r["error"] for r in own], "o-", ms=4, lw=0.8, color=colour(k), label=path.stem)
            axes[3].loglog([r["limit"] for r in own], [r["lights"] for r in own], LINES[method], ms=4, lw=0.8, color=colour(k))
        axis.plot([0.025, 0.5], [0.025, 0.5], color="0.5", lw=3, alpha=0.5)
        axis.set(title=method, xlabel="error limit", ylabel="error on other probes")
    axes[0].legend(fontsize=7)
    axes[3].set(title="lights chosen\n(dashed: tracked, points; dotted: havran-azimuth)", xlabel="error limit", ylabel="lights")
    for axis in axes:
        axis.set_xticks(TICKS, TICK_LABELS)
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    for axis in axes[:3]:
        axis.set_yticks(TICKS, TICK_LABELS)
    save(figure, rows, out, "requirement", "Error relative to what each probe receives; below the gray line it is within the limit.")
