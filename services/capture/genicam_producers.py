"""GenTL producers, the makers' libraries through which GenICam cameras are found and opened, and the package that speaks to them.

It is optional (`vemlight[genicam]`). EMVA GenTL 1.6.
"""

import ctypes
import logging
import os
import signal
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from vemlight.capture.genicam_controls import EXPOSURES, READABLE
from vemlight.capture.pixel_formats import PFNC_FORMATS
from vemlight.capture.v4l2 import CameraInfo
from vemlight.errors import UserError
from vemlight.files import notice, one_line
from vemlight.source_names import GENICAM

PRODUCERS = "GENICAM_GENTL64_PATH"  # the standard's list of folders with producers, .cti
FIRST = "first"  # instead of a camera's name


def faults() -> tuple[type[Exception], ...]:
    """What the packages raise for a camera or producer that fails."""
    from genicam import genapi, gentl  # pyright: ignore[reportMissingImports]

    return gentl.GenericException, genapi.GenericException


def check_producers(source: str) -> list[str]:
    """The producers of this machine. Raises UserError without the package, without a producer, and where none can be loaded."""
    try:
        with warnings.catch_warnings():  # the package changes the filter of all
            import harvesters.core  # noqa: F401  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UserError(f"{source}: is a GenICam camera, and harvesters is not installed; pip install 'vemlight[genicam]'") from error
    entries = [Path(entry) for entry in os.environ.get(PRODUCERS, "").split(os.pathsep) if entry]
    files = [str(path) for entry in entries for path in (sorted(entry.glob("*.cti")) if entry.is_dir() else [entry])]
    if not files:
        fault = f"{PRODUCERS} {f'names no folder with one ({entries[0]})' if entries else 'is not set'}"
        raise UserError(f"{source}: needs its maker's GenTL producer (.cti), and {fault}; install it, and set that to its folder")
    found = {path: _fault_of_producer(path) for path in files}
    for path, fault in found.items():
        if fault and not all(found.values()):
            notice(f"{path}: {fault}; the other producers are used")
    if all(found.values()):
        raise UserError(f"{files[0]}: {found[files[0]]}; install the camera maker's producer, and set {PRODUCERS} to its folder")
    return [path for path, fault in found.items() if not fault]


def _fault_of_producer(path: str) -> str:
    if not os.path.exists(path):
        return "there is no such GenTL producer"
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
        return f"cannot be loaded as a GenTL producer ({one_line(error).removeprefix(f'{path}: ')})"
    return "" if hasattr(library, "GCInitLib") else "is no GenTL producer"


class Connection(NamedTuple):
    """An open camera. acquirer: the package's; harvester: what it belongs to."""

    harvester: Any
    acquirer: Any
    id: str
    name: str  # maker and model


def connect(source: str, wanted: str) -> Connection:
    """Opens the camera of that id, serial number or name, or the FIRST. Raises UserError for one that is not there or cannot be opened."""
    from harvesters.core import ParameterKey, ParameterSet  # pyright: ignore[reportMissingImports]

    harvester = _searched(source)
    infos = [info.property_dict | {"info": info} for info in harvester.device_info_list]
    matching = [info for info in infos if wanted in (FIRST, info["id_"], info["serial_number"], info["user_defined_name"]) and wanted]
    try:
        if not matching:
            there = ", ".join(f"{GENICAM}{info['serial_number'] or info['id_']}" for info in infos)
            raise UserError(f"{source}: there is no such camera{f' but {there}' if there else ''}; plug it in, or see `vemlight doctor`")
        parameters = {ParameterKey.TIMEOUT_PERIOD_ON_UPDATE_EVENT_DATA_CALL: 0}  # ms
        handler = signal.getsignal(signal.SIGINT)
        try:
            acquirer = harvester.create(matching[0]["info"], config=ParameterSet(parameters))
        finally:
            if threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGINT, handler)  # the package takes Ctrl-C for itself
    except faults() as error:
        harvester.reset()
        raise UserError(f"{source}: cannot be opened ({one_line(error)}); end the program that uses it, or plug it in again") from error
    except UserError:
        harvester.reset()
        raise
    info = matching[0]
    return Connection(harvester, acquirer, info["id_"], f"{info['vendor'] or ''} {info['model'] or ''}".strip())


def _searched(source: str) -> Any:
    """The package's list of cameras, looked for now."""
    producers = check_producers(source)
    from harvesters.core import Harvester, ParameterKey, ParameterSet  # pyright: ignore[reportMissingImports]

    quiet = logging.getLogger("vemlight.genicam")  # the package's own prints tracebacks
    quiet.addHandler(logging.NullHandler())
    quiet.propagate = False
    harvester = Harvester(config=ParameterSet({ParameterKey.LOGGER: quiet}))
    for path in producers:
        harvester.add_file(path)
    harvester.update()
    return harvester


def list_genicam() -> list[CameraInfo]:
    """The cameras of this machine's producers; those in use by another program have no formats. Raises UserError as check_producers."""
    harvester = _searched(GENICAM.rstrip(":"))
    ids = [info.property_dict["serial_number"] or info.property_dict["id_"] for info in harvester.device_info_list]
    names = [info.property_dict["display_name"] or info.property_dict["model"] or "" for info in harvester.device_info_list]
    harvester.reset()
    cameras = []
    for id_, name in zip(ids, names, strict=True):
        try:
            cameras.append(_described(GENICAM + id_, id_, name))
        except (UserError, *faults()):
            cameras.append(CameraInfo(GENICAM + id_, name, [], is_free=False))
    return cameras


def _described(source: str, id_: str, name: str) -> CameraInfo:
    opened = connect(source, id_)
    try:
        nodes = opened.acquirer.remote_device.node_map
        offered = offered_formats(nodes)
        exposure = tuple(name for name in EXPOSURES if hasattr(nodes, name))[:1]
    finally:
        opened.harvester.reset()
    known, others = ([form for form in offered if (form in PFNC_FORMATS) is is_known] for is_known in (True, False))
    return CameraInfo(source, name, known, tuple(others), exposure)


def offered_formats(nodes: Any) -> list[str]:
    """Names of the pixel formats that a camera can be set to."""
    return [entry.symbolic for entry in nodes.PixelFormat.entries if entry.get_access_mode() in READABLE]


def on_incomplete(acquirer: Any, call: Callable[[], None]) -> None:
    """Lets the package `call` for each frame that has holes, which it drops."""
    from harvesters.core import Callback  # pyright: ignore[reportMissingImports]

    class Counting(Callback):
        def emit(self, context: object | None = None) -> None:
            call()

    acquirer.add_callback(acquirer.Events.INCOMPLETE_BUFFER, Counting())


def info_of(module: Any, name: str) -> Any:
    """What a producer says of a buffer or device; None where it does not."""
    try:
        return getattr(module, name)
    except faults():
        return None
