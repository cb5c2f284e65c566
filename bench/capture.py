"""Speed and accuracy of capture, with two charts: python -m bench.capture [OUT]   (OUT: docs/charts)

1. Raw codes to the polar map, 1024 x 1024 at 12 bits: time and energy error of nearest, bilinear and 4 x 4 gather, and of ours,
   for a sun of 0.27 degrees at 200 random positions.
2. Radiance recovered through a 12-bit log sensor with half a code of noise, over six decades.
3. Files: a lat-long image to its map, a recorded sequence read ahead and not.
"""

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
from numba import njit

from vemlight.capture.fisheye import fisheye_to_polar
from vemlight.capture.frames import FrameMaker
from vemlight.capture.lens import Lens, pixel_from_direction, write_lens
from vemlight.capture.manifest import read_manifest
from vemlight.capture.polar import latlong_to_polar, polar_from_latlong
from vemlight.capture.response import Log, code_from_radiance, radiance_table, write_response
from vemlight.capture.scatter import Threads, polar_from_codes
from vemlight.capture.sequence import FrameFile
from vemlight.capture.simulation.environment import Environment, SunDisc
from vemlight.capture.simulation.optics import fisheye_radiance
from vemlight.capture.simulation.sensor import VirtualCamera, exposed
from vemlight.capture.source import BUNDLED, FileSource, ReadAheadSource
from vemlight.light.sphere import angle_between, cell_directions, cell_solid_angles, direction_from_angles
from vemlight.settings import Capture

matplotlib.use("Agg")
from matplotlib import pyplot as plt

SIZE, ROWS, COLS = 1024, 90, 360
LENS = Lens(size=(SIZE, SIZE), f=(307.0, 307.0), c=(511.3, 511.8), k1=-0.005, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0)
SPAN_CODES = 4095 / np.log(1e9)
LOG12 = Log(bits=12, a=float(-SPAN_CODES * np.log(1e-3)), b=float(SPAN_CODES), c=1e-3)  # 1e-3 to 1e6
POSITIONS, SUN_RADIUS = 200, np.radians(0.135)
SUN = 5.0  # irradiance: radiance 2.9e5 in the disc


class Gather:
    """Gathers the image into cells: the mean of `side` x `side` points a cell, of the nearest pixel or interpolated (`between`)."""

    def __init__(self, side: int, between: bool):
        theta = (np.arange(ROWS * side) + 0.5) * (np.pi / 2 / ROWS / side)
        phi = (np.arange(COLS * side) + 0.5) * (2 * np.pi / COLS / side)
        x, y = np.moveaxis(pixel_from_direction(direction_from_angles(theta[:, None], phi[None, :]), LENS), -1, 0)
        if between:
            left, top = np.floor(x).astype(int), np.floor(y).astype(int)
            u, v = x - left, y - top
            taps = [((1 - u) * (1 - v), top, left), (u * (1 - v), top, left + 1), ((1 - u) * v, top + 1, left), (u * v, top + 1, left + 1)]
        else:
            taps = [(np.ones_like(x), np.rint(y).astype(int), np.rint(x).astype(int))]
        pixel = np.stack([row * SIZE + col for _, row, col in taps])
        weight = np.stack([w for w, _, _ in taps]) / side**2
        # to (cells, points and taps of a cell), equal pixels of a cell merged
        order = [a.reshape(len(taps), ROWS, side, COLS, side).transpose(1, 3, 0, 2, 4).reshape(ROWS * COLS, -1) for a in (pixel, weight)]
        starts, pixels, weights = [0], [], []
        for p, w in zip(*order, strict=True):
            unique, inverse = np.unique(p, return_inverse=True)
            pixels.append(unique)
            weights.append(np.bincount(inverse, w))
            starts.append(starts[-1] + len(unique))
        self.start, self.pixel = np.array(starts, np.int32), np.concatenate(pixels).astype(np.uint32)
        self.weight = np.concatenate(weights).astype(np.float32)

    def __call__(self, codes: np.ndarray, table: np.ndarray) -> np.ndarray:
        return _look(codes.reshape(-1), self.start, self.pixel, self.weight, table).reshape(ROWS, COLS)


@njit(cache=True)
def _look(codes, start, pixel, weight, table):
    polar = np.empty(len(start) - 1, np.float32)
    for c in range(len(polar)):
        total = np.float32(0)
        for m in range(start[c], start[c + 1]):
            total += weight[m] * table[codes[pixel[m]]]
        polar[c] = total
    return polar


def median_ms(call: Callable[[], object], rounds: int = 9, times: int = 15) -> float:
    """Median time of a call in the fastest of some rounds, because other work on the machine comes in bursts."""
    call()
    medians = []
    for _ in range(rounds):
        spent = []
        for _ in range(times):
            began = time.perf_counter()
            call()
            spent.append(time.perf_counter() - began)
        medians.append(float(np.median(spent)))
        time.sleep(0.05)
    return 1e3 * min(medians)


def suns(seed: int = 1) -> list[tuple[np.ndarray, np.ndarray]]:
    """(direction, codes (height, width) uint16) of a sun at random positions of the hemisphere, not on the horizon itself."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(POSITIONS):
        direction = direction_from_angles(np.arccos(rng.uniform(0.01, 1)), rng.uniform(0, 2 * np.pi))
        disc = SunDisc(direction, SUN_RADIUS, np.full(3, SUN))
        image = fisheye_radiance(Environment(np.zeros((2, 4, 3)), [disc]), np.eye(3), LENS)
        found.append((direction, code_from_radiance(image[..., 1], LOG12)))
    return found


def resampling(out: Path) -> None:
    """Chart 1: time against energy error."""
    solid = np.repeat(cell_solid_angles(ROWS, COLS, "hemisphere"), COLS).reshape(ROWS, COLS)
    where = cell_directions(ROWS, COLS, "hemisphere")
    table = np.zeros(65536, np.float32)
    table[:4096] = radiance_table(LOG12)
    fisheye_to_polar(LENS, ROWS, COLS, "hemisphere")  # compiled
    began = time.perf_counter()
    weights = fisheye_to_polar(LENS, ROWS, COLS, "hemisphere")
    print(f"weights made in {time.perf_counter() - began:.1f} s, {len(weights.pixel)} of them")
    methods: dict[str, Callable[[np.ndarray], np.ndarray]] = {}
    for name, side, between in (("nearest", 1, False), ("bilinear", 1, True), ("4 x 4 gather", 4, True)):
        gather = Gather(side, between)
        methods[name] = lambda codes, gather=gather: gather(codes, table)
    methods["area weights (ours)"] = lambda codes: polar_from_codes(codes, weights, table)
    two = Threads(2)
    methods["ours, two threads"] = lambda codes: polar_from_codes(codes, weights, table, two)
    frames = suns()
    raw = np.random.default_rng(0).integers(0, 4096, (SIZE, SIZE)).astype(np.uint16)
    sum_ms = median_ms(raw.sum)
    rows = []
    for name, method in methods.items():
        spent = median_ms(lambda method=method: method(raw))
        energy, off = [], []
        for direction, codes in frames:
            flux = method(codes) * solid
            energy.append(float(flux.sum(dtype=np.float64)) / SUN - 1)
            centre = np.einsum("ij,ijc->c", flux.astype(np.float64), where)
            off.append(np.degrees(angle_between(centre / max(np.linalg.norm(centre), 1e-300), direction)))
        rms, worst = float(np.sqrt(np.mean(np.square(energy)))), float(np.abs(energy).max())
        rows.append([name, f"{spent:.3f}", f"{spent / sum_ms:.2f}", f"{rms:.5f}", f"{worst:.5f}", f"{np.max(off):.3f}"])
        print(f"{name:20s} {spent:6.2f} ms, {spent / sum_ms:4.1f} sums; energy error rms {rms:.4f}, worst {worst:.4f}")
    head = ["method", "ms", "numpy_sums", "energy_rms", "energy_worst", "cell_centroid_worst_deg"]
    write_rows(out / "capture_resampling.csv", head, rows)
    figure, axes = plt.subplots(figsize=(6.4, 4.2))
    for name, spent, _, rms, worst, _ in rows:
        axes.errorbar(float(spent), float(rms), [[0], [float(worst) - float(rms)]], fmt="o", capsize=3)
        left = name == "ours, two threads"  # clear of the label for one thread
        axes.annotate(
            name, (float(spent), float(rms)), xytext=(-8 if left else 8, -3), textcoords="offset points", ha="right" if left else "left"
        )
    axes.set(xscale="log", yscale="log", xlabel="ms for 1024 x 1024, one thread unless named", xlim=(0.07, 8))
    axes.set_ylabel("energy error of a 0.27 degree sun\n(dot: RMS, bar: worst)")
    axes.axvline(sum_ms, color="0.7", linestyle=":")
    axes.text(1.03 * sum_ms, 0.3, "numpy's sum", rotation=90, color="0.5", transform=axes.get_xaxis_transform())
    axes.set_title("Raw codes to the polar map, 200 positions of the sun")
    figure.tight_layout()
    figure.savefig(out / "capture_resampling.png", dpi=120)


def centres(folder: Path) -> None:
    """Prints how far the samples of bright cells are from the sun, and the time of a whole frame."""
    write_lens(folder / "lens.toml", LENS)
    write_response(folder / "response.toml", LOG12)
    maker, threaded = FrameMaker(Capture(), folder), FrameMaker(Capture(threads=2), folder)
    where = cell_directions(ROWS, COLS, "hemisphere").reshape(-1, 3)
    solid = np.repeat(cell_solid_angles(ROWS, COLS, "hemisphere"), COLS)
    off, energy, codes = [], [], np.zeros((SIZE, SIZE), np.uint16)
    for direction, codes in suns():
        frame = maker.frame_from_codes("sun", codes, "mono", 0.0)
        at = where.copy()
        cells, centres, weights = frame.bright_cells
        at[cells] = 0
        np.add.at(at, cells, centres * weights[:, None])
        flux = frame.radiance[..., 1].ravel().astype(np.float64) * solid
        energy.append(flux.sum() / SUN - 1)
        centre = flux @ at
        off.append(np.degrees(angle_between(centre / np.linalg.norm(centre), direction)))
    print(
        f"with flux centres: energy worst {np.abs(energy).max():.5f}, direction off median {np.median(off):.3f}, "
        f"worst {np.max(off):.3f} degrees"
    )
    for name, made in (("one thread", maker), ("two threads", threaded)):
        spent = median_ms(lambda made=made: made.frame_from_codes("sun", codes, "mono", 0.0))
        print(f"whole frame, from codes to map, bright cells and counts, {name}: {spent:.2f} ms")


def photometry(out: Path) -> None:
    """Chart 2: error of the recovered radiance against the true one."""
    levels = np.logspace(-2, 4, 121)
    camera, none = VirtualCamera(lens=LENS, response=LOG12, noise_codes=0.5), np.zeros((1, 1, 1))
    rows = []
    for n, level in enumerate(levels):
        true = level * 10 ** np.random.default_rng(n).uniform(-0.025, 0.025, (64, 64, 3))  # all places between two codes
        codes = exposed(true, camera, none, (0, n)).astype(np.uint16)
        error = np.abs(radiance_table(LOG12)[codes] / true - 1)
        rows.append([f"{level:.6g}", f"{np.median(error):.6f}", f"{np.percentile(error, 95):.6f}"])
    write_rows(out / "capture_photometry.csv", ["radiance", "median_error", "p95_error"], rows)
    median, p95 = np.array([[float(r[1]), float(r[2])] for r in rows]).T
    print(f"radiance through 12-bit log with 0.5 codes of noise: median error {np.median(median):.4f}, worst level {median.max():.4f}")
    figure, axes = plt.subplots(figsize=(6.4, 3.8))
    axes.fill_between(levels, 100 * p95, color="0.9", label="95 % of pixels")
    axes.plot(levels, 100 * median, label="median")
    axes.axhline(1.5, color="0.6", linestyle=":", label="1.5 %")
    axes.set(xscale="log", xlabel="radiance (six decades of a sensor that has nine)", ylabel="error of one pixel, %", ylim=(0, None))
    axes.set_title("Radiance recovered from 12-bit log codes, noise 0.5 codes")
    axes.legend()
    figure.tight_layout()
    figure.savefig(out / "capture_photometry.png", dpi=120)


def files() -> None:
    """Prints the speed of files."""
    image = np.random.default_rng(0).random((512, 1024, 3), np.float32)
    weights = latlong_to_polar(512, 1024, ROWS, COLS, "hemisphere")
    print(f"lat-long 1024 x 512 to the map: {median_ms(lambda: polar_from_latlong(image, weights)):.2f} ms")
    entries = read_manifest(BUNDLED)
    frames = [FrameFile(BUNDLED / entry.name, k) for k, entry in enumerate(entries)]
    plain = FileSource(Capture(), frames, entries)
    for name, source in (("read when asked", plain), ("read ahead", ReadAheadSource(FileSource(Capture(), frames, entries)))):
        source.frame(0)
        spent = []
        for k in range(1, len(source)):
            time.sleep(0.01)  # what the next stage takes
            began = time.perf_counter()
            source.frame(k)
            spent.append(time.perf_counter() - began)
        print(f"bundled sequence, {name}: {1e3 * np.median(spent):.2f} ms a frame waited for")


def write_rows(path: Path, head: list[str], rows: list[list[str]]) -> None:
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([head, *rows])


if __name__ == "__main__":
    import tempfile

    parser = argparse.ArgumentParser(description="Speed and accuracy of capture, with two charts.")
    parser.add_argument("out", nargs="?", default="docs/charts", type=Path)
    charts: Path = parser.parse_args().out
    charts.mkdir(parents=True, exist_ok=True)
    resampling(charts)
    with tempfile.TemporaryDirectory() as scratch:
        centres(Path(scratch))
    photometry(charts)
    files()
