"""`vemlight doctor`: what works on this machine, each line pass, warn or fail with how to mend it."""

import os
import platform
import shutil
import socket
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Literal

import msgspec

from services.channels import SERVICES
from services.files import BadInput
from services.settings import Settings
from services.sockets import read_keys, runtime_folder

Grade = Literal["pass", "warn", "fail"]
SOFTWARE_GL = ("llvmpipe", "softpipe", "swrast", "swiftshader")
# Oldest versions that are safe to use; OpenEXR: the last release with the security fixes of 2026, libzmq: with those of its CURVE code.
FLOORS = {"OpenEXR": "3.4.14", "pyzmq": "27.0", "moderngl": "5.12", "numpy": "2.0", "numba": "0.60", "msgspec": "0.19", "aiohttp": "3.10"}
LIBZMQ_FLOOR = (4, 3, 5)
FREE_BYTES = 2**30  # a run of 640 x 480 writes about 6 MB a frame: 1 GB is three minutes at one frame a second


class Finding(msgspec.Struct, frozen=True):
    """One thing looked at."""

    grade: Grade
    what: str
    found: str
    mend: str = ""


def examine(settings: Settings) -> Iterator[Finding]:
    """Looks at one thing after another."""
    yield Finding("pass", "system", f"{platform.platform()}, Python {platform.python_version()}, {os.cpu_count()} cores")
    yield from _libraries()
    yield _gl()
    yield from _cameras()
    yield from _ports(settings)
    yield _sockets(settings)
    yield _sequence(settings)
    yield _disk(settings)


def _libraries() -> Iterator[Finding]:
    versions, old = [], []
    for name, floor in FLOORS.items():
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            old.append(f"{name} is missing")
            continue
        versions.append(f"{name} {version}")
        if _numbers(version) < _numbers(floor):
            old.append(f"{name} {version} is older than {floor}")
    if old:
        yield Finding("fail", "libraries", "; ".join(old), "install what requirements.lock names: make env")
    else:
        yield Finding("pass", "libraries", ", ".join(versions))

    import zmq

    found = f"{zmq.zmq_version()}, CURVE {'yes' if zmq.has('curve') else 'no'}"
    if zmq.zmq_version_info() < LIBZMQ_FLOOR or not zmq.has("curve"):
        yield Finding("fail", "libzmq", found, "install pyzmq from its wheel, which brings libzmq 4.3.5 with CURVE")
    else:
        yield Finding("pass", "libzmq", found)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".")[:3] if part.isdecimal())


def _gl() -> Finding:
    from services.renderer.programs import context_info, headless_context

    try:
        context = headless_context()
    except BadInput as error:
        return Finding("fail", "OpenGL", "no context", str(error))
    info = context_info(context)
    context.release()
    if any(name in info.lower() for name in SOFTWARE_GL):
        return Finding("warn", "OpenGL", info, "drawn by the processor: correct but slow; install the driver of your graphics card")
    return Finding("pass", "OpenGL", info)


def _cameras() -> Iterator[Finding]:
    from services.capture.v4l2 import list_cameras

    cameras = list_cameras()
    for camera in cameras:
        if camera.formats:
            yield Finding("pass", "camera", f"{camera.path}: {camera.card}, {', '.join(camera.formats)}")
        else:
            yield Finding("warn", "camera", f"{camera.path}: {camera.card} has no raw format", "use one with GREY, Y10, Y12, Y16 or Bayer")
    closed = [str(path) for path in sorted(Path("/dev").glob("video*")) if not os.access(path, os.R_OK | os.W_OK)]
    if closed:
        yield Finding("fail", "cameras", f"{', '.join(closed)} may not be opened", "join their group: sudo usermod -aG video $USER")
    elif not cameras:
        yield Finding("warn", "cameras", "none", "plug one in, or replay a recording: [capture] source = FOLDER")


def _ports(settings: Settings) -> Iterator[Finding]:
    wanted = [("viewer", settings.viewer.host, settings.viewer.port, "[viewer] port")]
    if settings.wire.transport == "tcp":
        first = settings.wire.port
        wanted += [("wire", "127.0.0.1", port, "[wire] port") for port in range(first, first + 2 * len(SERVICES))]
    for what, host, port, key in wanted:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host, port))
            except OSError as error:
                yield Finding("fail", f"port of the {what}", f"{host}:{port}: {error.strerror}", f"stop what holds it or change {key}")
            else:
                yield Finding("pass", f"port of the {what}", f"{host}:{port} is free")


def _sockets(settings: Settings) -> Finding:
    try:
        if settings.wire.transport == "ipc":
            return Finding("pass", "sockets", str(runtime_folder(settings.wire)))
        if settings.wire.keys:
            read_keys(Path(settings.wire.keys))
            return Finding("pass", "sockets", f"tcp with the keys in {settings.wire.keys}")
    except BadInput as error:
        return Finding("fail", "sockets", "cannot be used", str(error))
    return Finding("warn", "sockets", "tcp without keys", "unless the network is yours alone, `vemlight keys DIR` and set [wire] keys")


def _sequence(settings: Settings) -> Finding:
    from services.capture.source import open_source

    try:
        source = open_source(settings.capture)
    except BadInput as error:
        return Finding("fail", "source", "cannot be played", str(error))
    name = settings.capture.source or "the bundled sequence"
    return Finding("pass", "source", f"{name}: {len(source)} frames at {source.fps:g} a second")


def _disk(settings: Settings) -> Finding:
    folder = Path(settings.out) if settings.out and Path(settings.out).exists() else Path(tempfile.gettempdir())
    free = shutil.disk_usage(folder).free
    found = f"{free / 1e9:.1f} GB free at {folder}"
    if free < FREE_BYTES:
        return Finding("warn", "disk", found, "make room before writing pictures")
    return Finding("pass", "disk", found)
