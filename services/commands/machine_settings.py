"""`vemlight doctor --write FILE`: settings that hold their rate on this machine, found by running them.

Sizes of the picture are tried from large to small, with a reader of the pictures as a page is one, until one keeps up; it is then watched
for a minute.
"""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterator
from http.client import HTTPException
from pathlib import Path
from typing import NamedTuple
from urllib.request import urlopen

import msgspec

from vemlight.commands.doctor import Finding
from vemlight.errors import UserError
from vemlight.files import written_whole
from vemlight.runtime import wire
from vemlight.settings import Settings, Wire
from vemlight.viewer.saved_settings import HEAD, settings_file

SIDES = (2.0, 1.5, 1.0, 0.75, 0.5)  # of the settings' picture; without a GPU from 1 down
GPU_FRAME_MS = 33.0  # a GPU's target for a picture: sources have 25 to 30 a second
WINDOW_S = 10.0  # over which a rate is taken
SETTLE_S, WATCH_S = 10.0, 60.0  # from the first picture until the renderer knows its costs; how long a rate has to hold
HOLDS = 0.1  # of its mean: what a window may depart from it
KEEPS_UP = 0.75  # of the rate that the target of a picture allows: pictures begin when lights come, up to a frame of the source late
ENOUGH_LIGHTS = 20  # in a picture: docs/accuracy.md has what is seen of fewer
START_S = 240.0  # for compiled code at the first start, and for OpenGL


class Window(NamedTuple):
    """Pictures a second, and the fewest lights drawn in one, over WINDOW_S."""

    rate_hz: float
    lights: int


Windows = Generator[Window, None, None]


class Fit(NamedTuple):
    """Settings, and the windows in which they were watched."""

    settings: Settings
    windows: tuple[Window, ...]

    @property
    def rate_hz(self) -> float:
        """The mean rate."""
        return sum(window.rate_hz for window in self.windows) / len(self.windows)

    @property
    def departure(self) -> float:
        """The largest departure of a window from the mean rate, relative."""
        return max(abs(window.rate_hz / self.rate_hz - 1) for window in self.windows) if self.rate_hz else 1.0


def check_new(path: Path, settings: Settings) -> None:
    """Raises UserError for a file that exists, for a folder that does not, and for settings that no run can try."""
    if path.exists():
        raise UserError(f"{path}: exists already; remove it, or name another file")
    if not path.parent.is_dir():
        raise UserError(f"{path}: there is no folder {path.parent}; make it, or name another file")
    if settings.mode == "lossless":
        raise UserError('--write tries live pictures, and the settings have mode = "lossless", which is as fast as it is; leave out mode')
    if settings.wire.elsewhere:
        raise UserError("--write tries all services, and [wire] elsewhere says that another run has some; leave out elsewhere")
    if settings.fixtures.rig:
        raise UserError("--write tries settings, and [fixtures] rig could move lamps meanwhile; leave out rig")


def fitting(settings: Settings, on_gpu: bool, windows: Callable[[Settings], Windows], say: Callable[[str], None]) -> Fit:
    """The largest pictures that hold their rate. windows: runs settings and gives one window after another.

    Raises UserError where none does.
    """
    best = "nothing came"
    for candidate in candidates(settings, on_gpu):
        size = f"{candidate.renderer.width} x {candidate.renderer.height}"
        say(f"{size}: trying")
        with contextlib.closing(windows(candidate)) as seen:
            first = next(seen)
            say(f"{size}: {first.rate_hz:.1f} pictures a second with {first.lights} lights or more")
            best = f"{size} is drawn {first.rate_hz:.1f} times a second with {first.lights} lights"
            if first.rate_hz < KEEPS_UP * wanted_hz(candidate) or first.lights < ENOUGH_LIGHTS:
                continue
            fit = Fit(candidate, tuple(next(seen) for _ in range(round(WATCH_S / WINDOW_S))))
        say(f"{size}: {fit.rate_hz:.1f} pictures a second for {WATCH_S:g} s, within {fit.departure:.0%}")
        if fit.departure <= HOLDS:
            return fit
        best = f"{size} departs by {fit.departure:.0%} from {fit.rate_hz:.1f} pictures a second"
    raise UserError(f"no size of the picture holds its rate ({best}); stop other programs, or set [renderer] frame_ms higher")


def candidates(settings: Settings, on_gpu: bool) -> Iterator[Settings]:
    """Settings with larger or smaller pictures than these, the largest first, and a target time for a picture."""
    drawn = settings.renderer
    frame_ms = drawn.frame_ms or (GPU_FRAME_MS if on_gpu else 100.0)
    for side in SIDES:
        if side <= 1 or on_gpu:
            width, height = (max(16, 2 * round(side * each / 2)) for each in (drawn.width, drawn.height))  # even, as videos need them
            yield msgspec.structs.replace(settings, renderer=msgspec.structs.replace(drawn, width=width, height=height, frame_ms=frame_ms))


def wanted_hz(settings: Settings) -> float:
    """The rate that the target time of a picture allows, at most the source's."""
    return min(settings.capture.fps, 1e3 / (settings.renderer.frame_ms or 100.0))


def run_windows(settings: Settings) -> Windows:
    """Runs the settings and gives what their pictures did, window after window; the run ends when the generator is closed."""
    with tempfile.TemporaryDirectory() as folder:
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        file = Path(folder) / "vemlight.toml"
        file.write_bytes(settings_text(tried(settings, port)))
        command = [sys.executable, "-m", "vemlight", "run", str(file)]
        own_sockets = os.environ | {"XDG_RUNTIME_DIR": folder}
        run = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=own_sockets)
        try:
            yield from _windows(f"http://127.0.0.1:{port}", run)
        finally:
            run.send_signal(signal.SIGTERM)
            run.wait()


def tried(settings: Settings, port: int) -> Settings:
    """The settings of a trial: without end, with a page on `port` of this machine, and without files that it would write."""
    replace = msgspec.structs.replace
    return replace(
        settings, out="", mode="live", wire=Wire(),
        capture=replace(settings.capture, record="", recordings="", frames=0),
        renderer=replace(settings.renderer, video=""),
        viewer=replace(settings.viewer, host="127.0.0.1", port=port, token="", insecure=False),
    )  # fmt: skip


def _windows(url: str, run: subprocess.Popen[bytes]) -> Iterator[Window]:
    give_up_s = time.monotonic() + START_S
    while _frames(url)[0] == 0:
        if run.poll() is not None or time.monotonic() > give_up_s:
            raise UserError("the settings do not run here; start them by `vemlight run` to see why, or see what fails above")
        time.sleep(0.5)
    threading.Thread(target=_read_pictures, args=(url,), daemon=True).start()
    time.sleep(SETTLE_S)
    while True:
        (before, lights), start_s = _frames(url), time.monotonic()
        while time.monotonic() < start_s + WINDOW_S:
            time.sleep(1.0)
            lights = min(lights, _frames(url)[1])
        yield Window((_frames(url)[0] - before) / (time.monotonic() - start_s), lights)


def _frames(url: str) -> tuple[int, int]:
    """How many pictures the renderer has drawn, and the lights of the newest."""
    try:
        with urlopen(f"{url}/metrics", timeout=5) as answer:  # /healthz has status 503 until all is well
            lines = dict(line.rsplit(" ", 1) for line in answer.read().decode().splitlines() if not line.startswith("#"))
    except (OSError, HTTPException):  # not yet, or no longer
        return 0, 0
    done = lines.get('vemlight_frames_total{outcome="done",stage="renderer"}', 0)
    return round(float(done)), round(float(lines.get("vemlight_renderer_drawn_lights", 0)))


def _read_pictures(url: str) -> None:
    """Takes the pictures, as a page does, until the run ends."""
    with contextlib.suppress(OSError, HTTPException), urlopen(f"{url}/stream.mjpg", timeout=30) as stream:
        while stream.read(2**16):
            pass


def write_fit(path: Path, fit: Fit, findings: list[Finding]) -> None:
    """Writes the settings, with what was found and measured above them."""
    drawn = fit.settings.renderer
    lines = [f"{finding.what}: {finding.found}" for finding in findings if finding.what in ("processor", "OpenGL", "shadows", "camera")]
    measured = f"{drawn.width} x {drawn.height}: {fit.rate_hz:.1f} pictures a second for {WATCH_S:g} s, within {fit.departure:.0%}"
    fewest = min(window.lights for window in fit.windows)
    head = ["Made by `vemlight doctor --write` on this machine.", *lines, f"{measured}, with {fewest} lights or more; {_load()}"]
    camera = "For a camera: [capture] source = its name above and lens = its lens file (docs/camera.md); its own rate may be lower."
    if any(finding.what == "camera" and finding.grade == "pass" for finding in findings):
        head.append(camera)
    text = "".join(f"# {line}\n" for line in head).encode()
    with written_whole(path) as part:
        part.write_bytes(text + b"\n" + settings_text(fit.settings))


def settings_text(settings: Settings) -> bytes:
    """The settings as a file."""
    return settings_file(settings, wire.ControlMessage()).removeprefix(HEAD.encode()).lstrip()


def _load() -> str:
    """How busy the machine is besides."""
    return f"load {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores while it was measured"
