"""Flicker of lamps: how often a scene without lamps is taken for one with them, and what is left of lamps, by frame rate.

    VEMLIGHT_DATA=... python -m bench.flicker

Writes docs/charts/flicker_false_alarms.csv, runs of 10 s of each kind of light in which flicker was reported, and flicker_lamps.csv, error
and flicker of the default's lights and of those of `deflicker = false` where half of all light is one lamp on each mains.
"""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfilt

from bench.accuracy.maps import one
from bench.evaluation import points_of, points_of_lights, probe_irradiance
from bench.sequences import FRAMES, LAMP, LAMP_AT, NOISE, RIPPLE, SETTLE_S, Frame, World, disc, turned, world_from_latlong
from vemlight.files import written_whole
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.sampler.temporal.flicker import NO_FLICKER, flicker_after
from vemlight.settings import Sampler

OUT = Path(__file__).parents[1] / "docs" / "charts"
RATES = (21.0, 24.0, 25.0, 29.97, 30.0, 50.0, 60.0)
LAMPS = ((100.0,), (120.0,), (100.0, 120.0))
LOST = (0.0, 0.2)  # of the frames, at random
RUNS, SECONDS = 20, 10.0
JITTER_S = 1e-4  # of the stamps
SECOND_LAMP_AT = np.array([-0.5, -0.6, 0.6244998])
Row = dict[str, object]


def power(kind: str, times_s: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """The power of light without lamps at these times."""
    n, passed = len(times_s), np.diff(times_s, prepend=times_s[0])
    if kind == "clear sky":
        change = 3e-4 * generator.standard_normal(n)
    elif kind == "noise":
        change = 3e-3 * generator.standard_normal(n)
    elif kind == "random walk":
        change = np.cumsum(0.1 * np.sqrt(passed) * generator.standard_normal(n))
    elif kind == "quick clouds":
        change = np.zeros(n)
        for k in range(1, n):
            stays = np.exp(-passed[k] / 0.3)
            change[k] = stays * change[k - 1] + 0.1 * np.sqrt(1 - stays**2) * generator.standard_normal()
    elif kind == "slow waves":
        hertz, phase = generator.uniform(0.05, 1.5, 6), generator.uniform(0, 2 * np.pi, 6)
        change = (0.06 / np.sqrt(hertz) * np.sin(2 * np.pi * hertz * times_s[:, None] + phase)).sum(axis=1)
    else:  # a hand's tremor, 4 to 8 Hz
        rate_hz = 600.0
        shake = sosfilt(butter(2, [4, 8], "band", fs=rate_hz, output="sos"), generator.standard_normal(int((SECONDS + 2) * rate_hz)))
        change = 0.02 * np.asarray(shake)[np.int64(times_s * rate_hz)] / np.std(shake)
    return np.exp(change)


KINDS = ("clear sky", "noise", "random walk", "quick clouds", "slow waves", "tremor")


def false_alarms() -> Iterator[Row]:
    for rate in RATES:
        for lost in LOST:
            for kind in KINDS:
                alarms = frames = 0
                for seed in range(RUNS):
                    generator = np.random.default_rng(seed)
                    times = np.arange(round(SECONDS * rate)) / rate
                    times = times[generator.random(len(times)) >= lost] + generator.uniform(0, JITTER_S)
                    state, seen = NO_FLICKER, 0
                    for t, p in zip(times, power(kind, times, generator), strict=True):
                        state = flicker_after(state, float(t), np.array([p]))
                        seen += state.depth > 0
                    alarms, frames = alarms + (seen > 0), frames + seen
                yield {"fps": rate, "lost": lost, "light": kind, "runs": RUNS, "runs_with_alarm": alarms, "frames_with_alarm": frames}


def lamps(world: World, rate: float, hertz: tuple[float, ...]) -> Iterator[Frame]:
    """Half of all light from lamps of these frequencies, in two places; the truth is their mean."""
    generator = np.random.default_rng(4)
    places = (LAMP_AT, SECOND_LAMP_AT)[: len(hertz)]

    def lit(parts: list[float]):
        added = [disc(place, 4.0, part * LAMP / len(hertz) * world.power) for place, part in zip(places, parts, strict=True)]
        return turned(world, np.eye(3), added[0]._replace(**{
            name: np.concatenate([getattr(lamp, name) for lamp in added]) for name in added[0]._fields
        }))  # fmt: skip

    truth = lit([1.0] * len(hertz))
    for k in range(round(SETTLE_S * rate) + FRAMES):
        now = lit([1 + RIPPLE * np.cos(2 * np.pi * h * k / rate + 0.7) for h in hertz])
        seen = (now.polar * (1 + NOISE * generator.standard_normal(now.polar.shape))).astype(np.float32)
        yield Frame(k / rate, truth._replace(bright_cells=now.bright_cells), seen)


def lamps_left(world: World) -> Iterator[Row]:
    truth = None
    for rate in RATES:
        for hertz in LAMPS:
            frames = [*lamps(world, rate, hertz)]
            truth = probe_irradiance(points_of(frames[0].source))
            mean = luminance_from_rgb(truth.hard).mean()
            row: Row = {"fps": rate, "lamps_hz": "+".join(f"{h:g}" for h in hertz)}
            for name, settings in (("default", Sampler(count=64)), ("off", Sampler(count=64, deflicker=False))):
                state, errors, soft = initial_state(), [], []
                for frame in frames:
                    seen = SamplerInput(frame.seen, "hemisphere", frame.time_s, frame.source.bright_cells)
                    state, lights, _ = step(settings, state, seen)
                    got = probe_irradiance(points_of_lights(lights))
                    errors.append(np.sqrt(np.mean(luminance_from_rgb(got.hard - truth.hard) ** 2)) / mean)
                    soft.append(luminance_from_rgb(got.soft - truth.soft) / mean)
                flicker = np.sqrt(np.mean(np.diff(soft[-FRAMES:], axis=0) ** 2))
                row |= {f"error_{name}": float(np.mean(errors[-FRAMES:])), f"flicker_{name}": float(flicker)}
            yield row


def write(name: str, rows: list[Row]) -> None:
    with written_whole(OUT / name) as part, open(part, "w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows)
    for row in rows:
        print(*(f"{key} {value:.3g}" if isinstance(value, float) else f"{key} {value}" for key, value in row.items()), flush=True)


def main() -> None:
    write("flicker_false_alarms.csv", [*false_alarms()])
    write("flicker_lamps.csv", [*lamps_left(world_from_latlong(read_radiance(one("an interior"))[0]))])


if __name__ == "__main__":
    main()
