"""The number of lights that `error_percent` chooses, and the error that they have, beside the limit."""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from rich.progress import Progress

from bench.accuracy.drawing import colour, leave_margin, save
from bench.accuracy.maps import maps
from bench.evaluation import points_of, points_of_lights, probe_irradiance, read_source
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler

LIMITS_PERCENT = (40.0, 30.0, 20.0, 15.0, 10.0, 7.0)
SETTLING_FRAMES = 20  # in which the number of lights settles
DARKEST = 0.05  # of the mean irradiance, added to a probe's: as in vemlight.sampler.required_lights


def requirement(out: Path, progress: Progress) -> None:
    """The number of lights that `error_percent` chooses, and their error on probes that the choice did not use."""
    rows, paths = [], maps()
    task = progress.add_task("required lights", total=len(paths) * len(LIMITS_PERCENT) * 2)
    for path in paths:
        source = read_source(path)
        truth = probe_irradiance(points_of(source)).soft[500:] @ LUMINANCE_WEIGHTS  # the choice uses the first ones of the same sequence
        for method in ("tracked", "havran-azimuth"):
            for limit in LIMITS_PERCENT:
                settings = Sampler(method=method, filter="none", count=1024, error_percent=limit)
                state, lights = initial_state(), None
                for k in range(SETTLING_FRAMES):
                    state, lights, _ = step(settings, state, SamplerInput(source.polar, "hemisphere", k / 25, source.bright_cells))
                assert lights is not None
                got = probe_irradiance(points_of_lights(lights)).soft[500:] @ LUMINANCE_WEIGHTS
                error = float(np.sqrt(np.mean(((got - truth) / (truth + DARKEST * truth.mean())) ** 2)))
                rows.append({"map": path.stem, "method": method, "limit": limit / 100, "lights": len(lights.ids), "error": error})
                progress.advance(task)
    figure, axes = plt.subplots(1, 3, figsize=(17, 5.6), layout="constrained")
    leave_margin(figure, 0.05)
    for axis, method in zip(axes, ("tracked", "havran-azimuth"), strict=False):
        for k, path in enumerate(paths):
            own = [r for r in rows if r["map"] == path.stem and r["method"] == method]
            axis.loglog([r["limit"] for r in own], [r["error"] for r in own], "o-", ms=4, lw=0.8, color=colour(k), label=path.stem)
            axes[2].loglog([r["limit"] for r in own], [r["lights"] for r in own], "o-" if method == "tracked" else "x:", ms=4, lw=0.8,
                           color=colour(k))
        axis.plot([0.06, 0.5], [0.06, 0.5], color="0.5", lw=3, alpha=0.5)
        axis.set(title=method, xlabel="error limit", ylabel="error on other probes")
        axis.grid(alpha=0.3, which="both")
    axes[0].legend(fontsize=7)
    axes[2].set(title="lights chosen (dotted: havran-azimuth)", xlabel="error limit", ylabel="lights")
    axes[2].grid(alpha=0.3, which="both")
    save(figure, rows, out, "requirement", "Error relative to what each probe receives; below the gray line it is within the limit.")
