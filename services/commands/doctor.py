"""`vemlight doctor`: what works on this machine; each line passes, warns or fails, with a hint how to fix it."""

import os
import platform
import re
import shutil
import tempfile
from collections.abc import Collection, Iterator
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

from vemlight.commands.run_checks import port_taken
from vemlight.errors import UserError
from vemlight.files import group_hint, may_open
from vemlight.runtime.instances import camera_capture, rig_cameras, started
from vemlight.runtime.open_files import FEW_FILES, file_limit, hard_file_limit, peer_limit
from vemlight.runtime.token import is_loopback
from vemlight.runtime.transport import ROLES, endpoint, read_keys, runtime_folder
from vemlight.settings import Settings
from vemlight.source_names import is_live, shown_source

if TYPE_CHECKING:
    from vemlight.capture.v4l2 import CameraInfo

Grade = Literal["pass", "warn", "fail"]
OPTIONAL = ("embreex",)  # there is none for some processors; the line of the shadows says what is drawn without it
MIN_LIBZMQ = (4, 3, 5)  # the release with the security fixes of its CURVE code
MIN_FREE_BYTES = 2**30  # a run of 640 x 480 writes about 6 MB a frame: 1 GB is three minutes at one frame a second; 0.5 to 4 GB do
MIN_MEMORY_BYTES = 2**30  # the services of the bundled scene take 0.5 GB together, and the system its own


class Finding(msgspec.Struct, frozen=True):
    """The result of one check; `hint` says how to fix what does not pass."""

    grade: Grade
    what: str
    found: str
    hint: str = ""


def examine(settings: Settings) -> Iterator[Finding]:
    """Checks one item after another; stops after the libraries when one of them is missing, which the rest needs."""
    yield Finding("pass", "system", f"{platform.platform()}, Python {platform.python_version()}")
    yield _processor()
    libraries = list(_libraries())
    yield from libraries
    if any(finding.grade == "fail" for finding in libraries):
        return
    yield from _gl(settings)
    yield _encoder()
    yield _charts()
    yield from _cameras()
    yield from _genicam_cameras()
    yield from _ports(settings)
    yield _page(settings)
    yield _sockets(settings)
    yield _sequence(settings)
    yield _scene(settings)
    yield _disk(settings)
    yield _open_files()


def _processor() -> Finding:
    cores, memory = len(os.sched_getaffinity(0)), os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    found = f"{cores} core{'s' if cores > 1 else ''} for this process, {memory / 1e9:.1f} GB of memory"
    if memory < MIN_MEMORY_BYTES:
        return Finding("warn", "processor", found, "the services need 1 GB together; stop other programs, or make smaller pictures")
    if cores < 2:
        return Finding("warn", "processor", found, "all services run on it: expect few pictures a second; with --out none is lost")
    return Finding("pass", "processor", found)


def _libraries() -> Iterator[Finding]:
    versions, old = [], []
    try:
        required = [line for line in metadata.requires("vemlight") or [] if "extra ==" not in line]
    except metadata.PackageNotFoundError:
        required, old = [], ["vemlight itself is not installed"]
    for line in required:
        name, floor = re.split(r"[^\w.-]", line)[0], (re.findall(r">=([\d.]+)", line) or ["0"])[0]
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            if name not in OPTIONAL:
                old.append(f"{name} is missing")
            continue
        versions.append(f"{name} {version}")
        if _numbers(version) < _numbers(floor):
            old.append(f"{name} {version} is older than {floor}")
    if old:
        yield Finding("fail", "libraries", "; ".join(old), "install what requirements.lock names: make env")
        return
    yield Finding("pass", "libraries", ", ".join(versions))

    import zmq

    found = f"{zmq.zmq_version()}, CURVE {'yes' if zmq.has('curve') else 'no'}"
    if zmq.zmq_version_info() < MIN_LIBZMQ or not zmq.has("curve"):
        yield Finding("fail", "libzmq", found, "install pyzmq from its wheel, which brings libzmq 4.3.5 with CURVE")
    else:
        yield Finding("pass", "libzmq", found)


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split(".")[:3] if part.isdecimal())


def _gl(settings: Settings) -> Iterator[Finding]:
    from vemlight.renderer.gl.programs import closed_cards, context_info, draws_on_processor, open_context

    try:
        opened = open_context()
    except UserError as error:
        found, _, hint = str(error).rpartition("; ")
        yield Finding("fail", "OpenGL", found, hint)
        return
    found, on_processor = f"{context_info(opened.context)}, through {opened.through}", draws_on_processor(opened.context)
    opened.context.release()
    if not on_processor:
        yield Finding("pass", "OpenGL", found)
    else:
        found += f" (what came before it: {'; '.join(opened.refused)})" if opened.refused else ""
        closed = closed_cards()
        hint = "pictures are drawn by the processor, which is slow; install your GPU's driver, or give the container its device"
        found += f": {closed[0]} may not be opened by this user" if closed else ""
        yield Finding("warn", "OpenGL", found, group_hint(closed[0]) if closed else hint)
    yield _shadows(settings, on_processor)


def _shadows(settings: Settings, on_processor: bool) -> Finding:
    from vemlight.renderer.rays.embree import library
    from vemlight.renderer.shadows import shadows_of

    wanted = settings.renderer
    if kind := shadows_of(wanted.shadows, wanted.shadow_map, on_processor, library() is not None):
        return Finding("pass", "shadows", {"rays": "by rays, traced by Embree", "maps": "by maps"}[kind])
    hint = "install embreex: make env"
    if wanted.shadows == "rays":
        return Finding("fail", "shadows", '[renderer] shadows = "rays", and embreex is not installed', hint)
    return Finding("warn", "shadows", "by maps, since embreex is not installed", hint)


def _encoder() -> Finding:
    try:
        import av

        from vemlight.renderer.output.video import chosen_encoder

        encoder = chosen_encoder(".mp4", 640, 480)
    except Exception as error:  # a missing package, a library that does not load, encoders that were left out
        reason = " ".join(str(error).split())[:120]
        return Finding("fail", "videos", f"PyAV cannot write them ({reason})", "install PyAV from its wheel: make env")
    return Finding("pass", "videos", f"{encoder.shown}, PyAV {av.__version__}")


def _charts() -> Finding:
    try:
        return Finding("pass", "charts", f"matplotlib {metadata.version('matplotlib')}")
    except metadata.PackageNotFoundError:
        return Finding("warn", "charts", "matplotlib is not installed", "only `vemlight chart` needs it: pip install 'vemlight[bench]'")


def _cameras() -> Iterator[Finding]:
    from vemlight.capture.genicam_producers import PRODUCERS
    from vemlight.capture.pixel_formats import FORMATS
    from vemlight.capture.v4l2 import list_cameras

    cameras = list_cameras()
    stable_names = {os.path.realpath(link): link for link in sorted(Path("/dev/v4l/by-id").glob("*"))}
    letters = {form.name for form in FORMATS.values() if not form.name.endswith("-BE")}
    for camera in cameras:
        name = str(stable_names.get(camera.path, camera.path))  # does not change with the order of plugging in
        yield _camera(camera, name, letters)
    for path in sorted(Path("/dev").glob("video*")):
        if not may_open(path):
            yield Finding("fail", "camera", f"{path} may not be opened by this user", group_hint(path))
    if not any(Path("/dev").glob("video*")) and not os.environ.get(PRODUCERS):
        yield Finding("warn", "camera", "none", "plug one in (a container needs its device), or replay: [capture] source = FOLDER")


def _camera(camera: "CameraInfo", name: str, read: Collection[str]) -> Finding:
    """read: names of formats, for the hint."""
    others = f"; not read: {', '.join(camera.others)}" if camera.others else ""
    exposure = next((name for name in camera.controls if name.lower().startswith("exposure") and "auto" not in name), None)
    locks = f"--control {exposure}=N locks its exposure" if exposure else "it has no control of its exposure; lock it at the camera"
    if camera.formats:
        return Finding("pass", "camera", f"{name}: {camera.card}, {', '.join(camera.formats)}{others}; {locks}")
    found = f"{name}: {camera.card} has no format that is read{others}"
    return Finding("warn", "camera", found, f"use one that has any of {', '.join(sorted(read))}")


def _genicam_cameras() -> Iterator[Finding]:
    """Only where a producer is installed, which says that there are such cameras."""
    from vemlight.capture.genicam_producers import PRODUCERS, list_genicam
    from vemlight.capture.pixel_formats import PFNC_FORMATS

    if not os.environ.get(PRODUCERS):
        return
    try:
        cameras = list_genicam()
    except UserError as error:
        found, _, hint = str(error).rpartition("; ")
        yield Finding("warn", "camera", found, hint)
        return
    for camera in cameras:
        if camera.is_free:
            yield _camera(camera, camera.path, PFNC_FORMATS)
        else:
            yield Finding("warn", "camera", f"{camera.path}: {camera.card}, which cannot be opened", "end the program that uses it")
    if not cameras:
        yield Finding("warn", "camera", f"no GenICam camera is found by the producers of {PRODUCERS}", "plug one in, or set its address")


def _ports(settings: Settings) -> Iterator[Finding]:
    viewer, wire = settings.viewer, settings.wire
    yield _port("port of the viewer", viewer.host, [viewer.port], "[viewer] port")
    if wire.transport == "tcp":
        try:
            addresses = [endpoint(wire, name, role) for name in started(settings) for role in ROLES]
        except UserError as error:
            yield Finding("fail", "ports of the wire", "one is missing", str(error))
            return
        split = [address.removeprefix("tcp://").rpartition(":") for address in addresses]
        ports = [int(port) for host, _, port in split if is_loopback(host)]
        if ports:
            yield _port("ports of the wire", "127.0.0.1", ports, "[wire] port")


def _port(what: str, host: str, ports: list[int], key: str) -> Finding:
    taken = [f"{host}:{port}: {reason}" for port in ports if (reason := port_taken(host, port))]
    if taken:
        return Finding("fail", what, ", ".join(taken), f"stop the program that uses it, or change {key}")
    return Finding("pass", what, f"{host}:{', '.join(map(str, ports))} free")


def _page(settings: Settings) -> Finding:
    viewer = settings.viewer
    if is_loopback(viewer.host):
        return Finding("pass", "page", f"this machine only{', with a token' if viewer.token else ''}")
    if viewer.insecure:
        hint = "unless the network is yours alone, take [viewer] insecure out"
        return Finding("warn", "page", "everyone who reaches this machine may see and control it", hint)
    return Finding("pass", "page", "everyone on the network who has the token")


def _sockets(settings: Settings) -> Finding:
    try:
        if settings.wire.transport == "ipc":
            return Finding("pass", "sockets", str(runtime_folder(settings.wire)))
        if settings.wire.keys:
            read_keys(Path(settings.wire.keys))
            return Finding("pass", "sockets", f"tcp with the keys in {settings.wire.keys}")
    except UserError as error:
        return Finding("fail", "sockets", "cannot be used", str(error))
    return Finding("warn", "sockets", "tcp without keys", "unless the network is yours alone, `vemlight keys DIR` and set [wire] keys")


def _sequence(settings: Settings) -> Finding:
    from vemlight.capture.source import open_source

    if settings.rig.file:
        return _rig(settings)
    if is_live(settings.capture.source):
        return Finding("pass", "source", f"{shown_source(settings.capture.source)}: a live one, which is opened by a run alone")
    try:
        source = open_source(settings.capture)
    except UserError as error:
        return Finding("fail", "source", "cannot be played", str(error))
    name = settings.capture.source or "the bundled sequence"
    return Finding("pass", "source", f"{name}: {len(source)} frames at {source.fps:g} a second")


def _rig(settings: Settings) -> Finding:
    """The cameras of a rig, each by its name."""
    from vemlight.capture.source import open_files
    from vemlight.fuse.check import check_cameras

    try:
        check_cameras(Path(settings.rig.file), [], [])
        found = []
        for camera in rig_cameras(settings.rig.file):
            live = is_live(camera.source)
            frames = "live" if live else f"{len(open_files(camera_capture(settings, camera.name)))} frames"
            found.append(f"{camera.name} ({shown_source(camera.source)}, {frames})")
    except UserError as error:
        return Finding("fail", "rig", "cannot be used", str(error))
    return Finding("pass", "rig", f"{settings.rig.file}: {', '.join(found)}")


def _scene(settings: Settings) -> Finding:
    from vemlight.renderer.scene.scene import load_scene

    try:
        scene = load_scene(Path(settings.renderer.scene) if settings.renderer.scene else None)
    except UserError as error:
        return Finding("fail", "scene", "cannot be drawn", str(error))
    triangles = sum(len(mesh.geometry.triangles) for mesh in scene.meshes)
    return Finding("pass", "scene", f"{settings.renderer.scene or 'the bundled scene'}: {len(scene.meshes)} meshes, {triangles} triangles")


def _disk(settings: Settings) -> Finding:
    wanted = Path(settings.out or tempfile.gettempdir())
    folder = next(path for path in (wanted, *wanted.parents) if path.exists())  # the nearest that exists
    found = f"{shutil.disk_usage(folder).free / 1e9:.1f} GB free at {folder}"
    if not os.access(folder, os.W_OK):
        return Finding("fail", "disk", f"{folder} may not be written to", "choose another --out, or another TMPDIR")
    if shutil.disk_usage(folder).free < MIN_FREE_BYTES:
        return Finding("warn", "disk", found, "make room before writing pictures")
    return Finding("pass", "disk", found)


def _open_files() -> Finding:
    hard, peers = hard_file_limit(), peer_limit(hard_file_limit())
    found = f"{file_limit()}, which each service raises to {hard}: up to {peers} peers of each"
    if hard < FEW_FILES:
        hint = f"raise the hard limit to {FEW_FILES} or more: ulimit -Hn, systemd's LimitNOFILE=, docker's --ulimit nofile="
        return Finding("warn", "open files", found, hint)
    return Finding("pass", "open files", found)
