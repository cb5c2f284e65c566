"""What would keep a run from working, found before anything is started: settings, source, scene, plate, rig, the page's address."""

import io
import os
import socket
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from pathlib import Path

import msgspec

from vemlight.errors import UserError, of_setting
from vemlight.files import checked_utf8, group_hint, may_open
from vemlight.journal import DYING_S
from vemlight.runtime.channels import service_of
from vemlight.runtime.instances import camera_capture, captures, instances, rig_cameras, started
from vemlight.runtime.transport import endpoint
from vemlight.settings import Capture, Plate, Settings
from vemlight.settings_file import check_settings
from vemlight.source_names import is_camera, is_genicam, is_live, is_stream

MEMORY_DEVICES = 1  # major number of /dev/null, /dev/zero and their like (Linux, admin-guide/devices.txt)
MAPS = ("fps", "rows", "cols", "coverage", "frames", "speed", "threads")  # keys under which the bundled sequence plays, whatever they are


def check_run(settings: Settings, file: Path | None, source_option: bool) -> None:
    """Raises UserError that names the settings' `file`, or with `source_option` --source, and the key, the file it names, and the way out.

    What the package brings with it is not looked at: it is right, and reading it takes a second.
    """
    checked_utf8(settings, "a settings file")  # as the services get them
    check_settings(settings, file)
    here = [service for service in settings.services if service not in settings.wire.elsewhere]
    if settings.rig.file:
        with _named(file, "[rig] file"):
            _check_rig(settings)
    elif "capture" in here:
        _check_capture(settings.capture, file, source_option)
    with _named(file, ""):
        _check_processes(settings)
    if "plate" in here:
        with _named(file, "[plate] source"):
            _check_plate(settings.plate)
    if "fixtures" in here:
        from vemlight.fixtures.check import check_rig_file

        with _named(file, "[fixtures] rig"):
            check_rig_file(Path(settings.fixtures.rig))
    if "renderer" in here:
        _check_renderer(settings, file)
    if settings.wire.keys:
        from vemlight.runtime.transport import read_keys

        with _named(file, "[wire] keys"):
            read_keys(Path(settings.wire.keys))
    if "viewer" in here and (reason := _port_kept(settings.viewer.host, settings.viewer.port)):
        address = f"{settings.viewer.host}:{settings.viewer.port}"
        with _named(file, "[viewer] host, port"):
            raise UserError(f"the viewer cannot listen at {address} ({reason}); stop what holds it, or choose another")


def _check_capture(capture: Capture, file: Path | None, source_option: bool) -> None:
    for name in capture.lenses:
        with _named(file, "[capture] lens"):
            _read_lens(Path(name))
    if capture.response:
        with _named(file, "[capture] response"):
            _read_response(Path(capture.response))
    with _named(None if source_option else file, "--source" if source_option else "[capture] source"):
        _check_source(capture)


def _check_renderer(settings: Settings, file: Path | None) -> None:
    """Raises UserError for a scene, a measured lamp or a video that the renderer could not use."""
    if settings.renderer.scene:
        from vemlight.renderer.scene.scene import load_scene

        with _named(file, "[renderer] scene"):
            load_scene(Path(settings.renderer.scene))
    if settings.renderer.lamp:
        from vemlight.renderer.scene.measured_lamps import lamp_light

        if not settings.rig.file:
            raise UserError(f"{file}: [renderer] lamp: stands for a light that cameras of a rig locate; set [rig] file, or leave it out")
        for number, lamp in enumerate(settings.renderer.lamp, 1):
            with _named(file, f"[renderer] lamp {number}"):
                lamp_light(lamp)
    if settings.renderer.video:
        from vemlight.renderer.output.video import check_video_settings

        with _named(file, ""):
            check_video_settings(settings)


@contextmanager
def _named(file: Path | None, key: str) -> Iterator[None]:
    """Puts the settings' file, if there is one, and the key before the text of a UserError; notices are left to the services."""
    with of_setting(": ".join(filter(None, (str(file or ""), key)))), redirect_stderr(io.StringIO()):
        yield


def _read_lens(path: Path) -> None:
    from vemlight.capture.lens import read_lens

    read_lens(path)


def _read_response(path: Path) -> None:
    from vemlight.capture.response import read_response

    read_response(path)


def _check_source(capture: Capture) -> None:
    if is_stream(capture.source):
        return  # a server that is asked twice may refuse the second: capture itself says what is wrong
    if is_camera(capture.source):
        check_camera(capture.source)
    elif msgspec.structs.replace(capture, **{key: getattr(Capture(), key) for key in MAPS}) != Capture():
        from vemlight.capture.source import open_files

        open_files(capture).check()


def _check_rig(settings: Settings) -> None:
    """Raises UserError for a rig of cameras of which one that is started here cannot be used, or which do not go together."""
    from vemlight.capture.source import open_files
    from vemlight.fuse.check import check_cameras

    path = Path(settings.rig.file)
    check_cameras(path, [], [])
    _check_devices(settings)
    fps, frames, some_live = [], [], False
    for camera in rig_cameras(settings.rig.file) if "capture" not in settings.wire.elsewhere else ():
        capture = camera_capture(settings, camera.name)
        with of_setting(f"{path}: camera {camera.name}"):
            for name in capture.lenses:
                _read_lens(Path(name))
            if capture.response:
                _read_response(Path(capture.response))
            _check_source(capture)
            if is_live(capture.source):
                some_live = True
            else:
                source = open_files(capture)
                fps.append(source.fps)
                frames.append(len(source))
    if not some_live:
        check_cameras(path, fps, frames)


def _check_processes(settings: Settings) -> None:
    """Raises UserError where there is nothing to start, or processes cannot be reached, or a camera is named that the rig has not."""
    wire = settings.wire
    names = instances(settings)
    if not started(settings):
        raise UserError("[wire] elsewhere: names all services, and nothing is left to start; leave out those that shall run here")
    if wire.elsewhere and wire.transport == "ipc" and not wire.folder:
        found = "the sockets of another run are in a folder that its own settings name"
        raise UserError(f"[wire] elsewhere: {found}; set [wire] folder to the same one in both")
    for key in ("hosts", "ports") if settings.rig.file else ():
        for name in getattr(wire, key):
            if service_of(name) == "capture" and name != "capture" and name not in names:
                cameras = ", ".join(captures(settings))
                raise UserError(f"[wire.{key}] {name}: {settings.rig.file} has no such camera; name one of {cameras}")
    if wire.transport == "tcp" or wire.folder:
        for name in names:
            endpoint(wire, name, "publish")


def _check_devices(settings: Settings) -> None:
    """Raises UserError where two cameras of the rig, started here, read one device, which the kernel gives to one of them."""
    users: dict[str, str] = {}
    here = started(settings)
    for camera in rig_cameras(settings.rig.file):
        if is_camera(camera.source) and camera.instance in here:
            device = os.path.realpath(camera.source)
            if other := users.get(device):
                names = f"cameras {other} and {camera.name} both read {device}"
                raise UserError(f"{settings.rig.file}: {names}, which one program at a time may; name each its own")
            users[device] = camera.name


def _check_plate(plate: Plate) -> None:
    if is_genicam(plate.source):
        raise UserError(f"{plate.source}: is a GenICam camera, which the light is taken from; name a video, pictures, or /dev/videoN")
    if is_camera(plate.source):
        check_camera(plate.source)
    elif plate.source:
        from vemlight.plate.video_source import open_video_source

        open_video_source(Path(plate.source), plate.fps).picture(0)


def check_camera(source: str) -> None:
    """Raises UserError for what is no camera, is not there, or may not be opened; of GenICam's, for want of what finds them."""
    if is_genicam(source):
        from vemlight.capture.genicam_producers import check_producers

        check_producers(source)
        return
    device = Path(source)
    if not device.exists():
        raise UserError(f"{device}: there is no such camera; plug it in, or see `vemlight doctor`")
    status = device.stat()
    if not stat.S_ISCHR(status.st_mode) or os.major(status.st_rdev) == MEMORY_DEVICES:
        raise UserError(f"{device}: is no camera; name a file, a folder or /dev/videoN")
    if not may_open(device):
        raise UserError(f"{device}: may not be opened by this user; {group_hint(device)}")


def _port_kept(host: str, port: int) -> str:
    """Why nothing can listen at a TCP port for DYING_S: the viewer of a run that was just killed may have it a moment longer."""
    until_s = time.monotonic() + DYING_S
    while (reason := port_taken(host, port)) and time.monotonic() < until_s:
        time.sleep(DYING_S / 20)
    return reason


def port_taken(host: str, port: int) -> str:
    """Why nothing can listen at a TCP port; empty when it can."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            return error.strerror or str(error)
    return ""
