"""Which processes a run has: each service once, and the capture once for each camera of a rig. Who takes whose frames among them.

The rig's file is read here for what a process needs to know of the cameras before any map is made; services/fuse/rig_file.py checks the
whole of it.
"""

from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import read_toml
from vemlight.runtime.channels import UPSTREAM, Instance, Service
from vemlight.settings import Capture, Settings
from vemlight.source_names import is_live, is_path, shown_source

MAX_CAMERAS = 16  # the sets of cameras that see a light are looked through; a stage has 4 to 8
Camera = TypeVar("Camera", bound=msgspec.Struct)


class RigCamera(msgspec.Struct, frozen=True):
    """What a capture needs of a camera in a rig's file; paths are absolute after `rig_cameras`."""

    name: Annotated[str, Meta(pattern="^[a-z0-9-]{1,32}$")]
    source: Annotated[str, Meta(min_length=1, max_length=4096)]
    lens: str = ""
    response: str = ""

    @property
    def instance(self) -> Instance:
        return f"capture.{self.name}"


class _Rig(msgspec.Struct, frozen=True):
    camera: Annotated[tuple[RigCamera, ...], Meta(min_length=1, max_length=MAX_CAMERAS)]


class Input(NamedTuple):
    """Frames of one kind that an instance publishes."""

    instance: Instance
    kind: str


@cache
def rig_cameras(file: str) -> tuple[RigCamera, ...]:
    """The cameras of a rig's file; none for an empty name. Raises UserError for a file that is no rig."""
    if not file:
        return ()
    return tuple(with_absolute_paths(camera, Path(file)) for camera in read_toml(Path(file), _Rig).camera)


def with_absolute_paths(camera: Camera, file: Path) -> Camera:
    """A camera of a rig's file, whose source, lens and response are relative to its folder there, unless the source has no path."""
    folder, paths = file.resolve().parent, msgspec.structs.asdict(camera)
    changed: dict[str, Any] = {key: str(folder / paths[key]) for key in ("source", "lens", "response") if paths[key]}
    if not is_path(paths["source"]):
        changed["source"] = paths["source"]
    return msgspec.structs.replace(camera, **changed)


def camera_capture(settings: Settings, name: str) -> Capture:
    """The `[capture]` of one camera of the rig: its own source, lens and response, and all else as for the others. Raises UserError."""
    cameras = {camera.name: camera for camera in rig_cameras(settings.rig.file)}
    if not cameras:
        raise UserError(f"capture: {name}: there is one camera; leave out {name}, or name a rig of cameras by [rig] file")
    if name not in cameras:
        wrong = f"{name}: {settings.rig.file} has no such camera" if name else f"{settings.rig.file} has several cameras"
        raise UserError(f"capture: {wrong}; name one of {', '.join(cameras)}")
    camera, capture = cameras[name], settings.capture
    if settings.mode == "lossless" and is_live(camera.source):
        text = f"camera {name}: {shown_source(camera.source)} is live"
        raise UserError(f'{settings.rig.file}: {text}, and mode = "lossless" replays files; use mode = "live"')
    record = str(Path(capture.record) / name) if capture.record else ""
    return msgspec.structs.replace(capture, source=camera.source, lens=camera.lens, response=camera.response, record=record)


def instance_of(settings: Settings, service: Service) -> Instance:
    """What the one process of `service` is called, by `[wire.names]`."""
    return settings.wire.names.get(service, service)


def captures(settings: Settings) -> tuple[Instance, ...]:
    """One for each camera."""
    if settings.rig.file:
        return tuple(camera.instance for camera in rig_cameras(settings.rig.file))
    return (instance_of(settings, "capture"),)


def instances(settings: Settings) -> tuple[Instance, ...]:
    """All that belong to the settings, each after its upstream. Raises UserError for a rig that cannot be read."""
    services = sorted(settings.services, key=lambda service: (service != "capture", service != "fuse"))
    return tuple(instance for service in services for instance in _named(settings, service))


def started(settings: Settings) -> tuple[Instance, ...]:
    """Those that this run starts itself: all but those of the services in `[wire] elsewhere`."""
    elsewhere = {name for service in settings.wire.elsewhere for name in _named(settings, service)}
    return tuple(instance for instance in instances(settings) if instance not in elsewhere)


def _named(settings: Settings, service: Service) -> tuple[Instance, ...]:
    return captures(settings) if service == "capture" else (instance_of(settings, service),)


def arguments(settings: Settings, instance: Instance) -> tuple[str, ...]:
    """What the process of an instance is given behind the settings' file: a capture the name of its camera in the rig."""
    service, _, name = instance.partition(".")
    return (name,) if service == "capture" and settings.rig.file else ()


def upstream(settings: Settings, service: Service) -> tuple[Instance, ...]:
    """Whose frames `service` takes; none of a source."""
    if service == "sampler" and settings.rig.file:
        return (instance_of(settings, "fuse"),)
    before = UPSTREAM[service]
    return _named(settings, before) if before else ()


def producer(settings: Settings, kind: str) -> Input:
    """Whose frames of a kind belong to the lights: the map that they are made of, the near lights beside it, the plate."""
    if kind == "map":
        return Input(upstream(settings, "sampler")[0], kind)
    return Input(instance_of(settings, "fuse" if kind == "points" else "plate"), kind)
