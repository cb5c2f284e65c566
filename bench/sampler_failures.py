"""Where the sampler's methods degrade: python -m bench.sampler_failures. Writes docs/charts/sampler_failures.csv and .png.

One small multiple for each case: error of the irradiance at the probes, frame by frame, against the map of that frame (so the delay of
a filter is an error; for lamps on mains it is the change from frame to frame), for the 2005 method with its filter, without, with other
filters, for the other warps, and for tracked lights, as points and soft (the default). COUNT lights, 25 fps.
"""

import csv
from collections.abc import Callable
from functools import partial
from pathlib import Path

import matplotlib
import numpy as np

from bench.evaluation import judged_softened
from bench.methods import POINTS, SOFT
from vemlight.files import written_whole
from vemlight.sampler.light_map import light_map
from vemlight.sampler.probes import irradiance_of_map, probes
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.settings import Sampler as Settings

matplotlib.use("Agg")
from matplotlib import pyplot as plt

COUNT = 72
Sampler = partial(Settings, method="havran-azimuth", count=COUNT, deflicker=False)  # the filters, gloss set and clusters of 2005

OUT = Path(__file__).parents[1] / "docs" / "charts"
ROWS, COLS, FRAMES, FPS = 60, 240, 48, 25.0
LOST = (20, 21, 22, 30)
MAINS = "lamp of 100 Hz"
VARIANTS = {
    "havran-azimuth, fir2005": Sampler(),
    "havran-azimuth, none": Sampler(filter="none"),
    "havran-azimuth, iir": Sampler(filter="iir"),
    "havran-azimuth, fir2005, deflicker": Sampler(deflicker=True),
    "havran-radius, none": Sampler(method="havran-radius", filter="none"),
    "standard, none": Sampler(method="standard", filter="none"),
    POINTS: Settings(count=COUNT, soft=False),
    SOFT: Settings(count=COUNT),
}
Sequence = list[tuple[float, np.ndarray]]  # times in s and maps
Line = tuple[str, str, int, float, float]  # case, variant, frame, error, change


def sky() -> np.ndarray:
    """Brighter towards the horizon and to one side."""
    theta, phi = (np.arange(ROWS) + 0.5) / ROWS, (np.arange(COLS) + 0.5) / COLS * 2 * np.pi
    gray = (1 + theta[:, None] ** 2) * (1.3 + np.cos(phi - 1)[None, :])
    return (gray[..., None] * [0.8, 1.0, 1.3]).astype(np.float32)


def with_sun(theta_deg: float, phi_deg: float, power: float, base: np.ndarray) -> np.ndarray:
    """`base` with a sun of 4 degrees and of `power` times the sky's 2 pi sr of radiance 1."""
    theta, phi = (np.arange(ROWS) + 0.5) * (np.pi / 2 / ROWS), (np.arange(COLS) + 0.5) * (2 * np.pi / COLS)
    at, to = np.radians(theta_deg), np.radians(phi_deg)
    cosine = np.cos(theta)[:, None] * np.cos(at) + np.sin(theta)[:, None] * np.sin(at) * np.cos(phi - to)[None, :]
    disc = np.clip(1.5 - np.arccos(np.clip(cosine, -1, 1)) / np.radians(2.0), 0, 1)  # a soft rim, so that it moves smoothly
    weights = disc * np.sin(theta)[:, None]
    radiance = power * 2 * np.pi * disc / (weights.sum() * (np.pi / 2 / ROWS) * (2 * np.pi / COLS))
    return base + radiance[..., None].astype(np.float32)


def even(maps: Callable[[int], np.ndarray], fps: float = FPS, frames: int = FRAMES) -> Sequence:
    return [(k / fps, maps(k)) for k in range(frames)]


def mains(fps: float) -> Sequence:
    """A lamp of 100 Hz over the sky; the last 48 of 112 frames are charted, when the flicker has been seen for long enough."""
    return even(lambda k: with_sun(40, 100, 2 * (1 + 0.4 * np.sin(200 * np.pi * k / fps)), sky()), fps, 64 + FRAMES)


def cases() -> dict[str, Sequence]:
    generator, base, black = np.random.default_rng(1), sky(), np.zeros((ROWS, COLS, 3), np.float32)
    pixel, ring, damaged = black.copy(), black.copy(), base.copy()
    pixel[25, 100], ring[-1] = 1.0, 1.0
    damaged[10:20, 50:80] = np.nan
    zenith = [(abs(30 - 60 * k / 47), 90 if k < 24 else 270) for k in range(FRAMES)]
    return {
        "black frames 20 to 22": even(lambda k: black if 20 <= k <= 22 else with_sun(40, 100, 3, base)),
        "one lit pixel": even(lambda k: pixel),
        "sun 10^6 times its sky": even(lambda k: with_sun(40, 100 + 0.5 * k, 1e6, base)),
        "sun through the zenith": even(lambda k: with_sun(*zenith[k], 3, base)),
        "sun through phi = 0": even(lambda k: with_sun(50, (340 + 40 * k / 47) % 360, 3, base)),
        "lamp off at 16, on at 32": even(lambda k: base if 16 <= k < 32 else with_sun(40, 100, 3, base)),
        "two opposite lamps": even(lambda k: with_sun(60, 0, 2, with_sun(60, 180, 2, base * np.float32(0.01)))),
        "light on the horizon alone": even(lambda k: ring),
        "noise of 5 %": even(lambda k: (base * (1 + 0.05 * generator.standard_normal((ROWS, COLS, 1)))).astype(np.float32)),
        "frames 20 to 22 and 30 lost": [x for x in even(lambda k: with_sun(40, 90 + k, 3, base)) if round(x[0] * FPS) not in LOST],
        "nan in a window from 20 to 24": even(lambda k: damaged if 20 <= k <= 24 else base),
        f"{MAINS} at 21 fps": mains(21.0),
        f"{MAINS} at 25 fps": mains(25.0),
        f"{MAINS} at 30 fps": mains(30.0),
    }


def errors(settings: Settings, sequence: Sequence) -> tuple[np.ndarray, np.ndarray]:
    """Error and change (frames,) of the irradiance, relative to the mean over the probes and frames."""
    at, state = probes(256, "hemisphere"), initial_state()
    truth, got = [], []
    for time_s, radiance in sequence:
        state, lights, _ = step(settings, state, SamplerInput(radiance, "hemisphere", time_s))
        truth.append(irradiance_of_map(at, light_map(radiance, "hemisphere").radiance, "hemisphere"))
        got.append(judged_softened(lights, len(at.normals)))
    scale = np.mean(truth)
    change = np.diff(np.array(got), axis=0, prepend=got[:1])
    return np.linalg.norm(np.array(got) - truth, axis=1) / scale / 16, np.linalg.norm(change, axis=1) / scale / 16  # 16: root of the probes


def measured() -> list[Line]:
    lines: list[Line] = []
    for name, sequence in cases().items():
        for variant, settings in VARIANTS.items():
            if variant.endswith("deflicker") and not name.startswith(MAINS):
                continue  # does nothing where nothing flickers
            error, change = (x[-FRAMES:] for x in errors(settings, sequence))
            lines += [(name, variant, k, float(e), float(c)) for k, (e, c) in enumerate(zip(error, change, strict=True))]
        own = {v: [line[3] for line in lines if line[:2] == (name, v)] for v in VARIANTS}
        print(name, {variant: f"{np.mean(error):.3f}" for variant, error in own.items() if error}, flush=True)
    return lines


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    lines = measured()
    with written_whole(OUT / "sampler_failures.csv") as part, open(part, "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(("case", "variant", "frame", "error", "change"))
        table.writerows((*line[:3], f"{line[3]:.5f}", f"{line[4]:.5f}") for line in lines)
    chart(lines, OUT / "sampler_failures.png")


def chart(lines: list[Line], path: Path) -> None:
    names = list(dict.fromkeys(line[0] for line in lines))
    figure, axes = plt.subplots(4, 4, figsize=(15, 12), sharex=True)
    for axis, name in zip(axes.flat, names, strict=False):
        for k, variant in enumerate(VARIANTS):
            column = 4 if name.startswith(MAINS) else 3
            values = [max(line[column], 1e-4) for line in lines if line[:2] == (name, variant)]
            axis.semilogy(values, f"C{k}", label=variant, linewidth=2.4 if variant == SOFT else 1.8 - 0.15 * k)  # those below still show
        axis.set_title(name + (": change a frame" if name.startswith(MAINS) else ""), fontsize=9)
        axis.set_ylim(3e-4, 3)
        axis.grid(alpha=0.3)
    for axis in axes.flat[len(names) :]:
        axis.axis("off")
    figure.legend(*axes.flat[-3].get_legend_handles_labels(), loc="lower right", bbox_to_anchor=(0.98, 0.05))
    figure.supxlabel("frame")
    figure.supylabel("error of the irradiance, RMS over 256 probes, relative to their mean")
    figure.text(0.01, 0.005, f"python -m bench.sampler_failures; {COUNT} lights, map 60 x 240", fontsize=7)
    figure.tight_layout(rect=(0.01, 0.02, 1, 1))
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main()
