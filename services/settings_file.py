"""Settings from a file or a command's options, and which values do not go together."""

import re
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec

from vemlight.errors import UserError
from vemlight.file_kinds import BINARY_UNTIL, file_kind
from vemlight.files import read_toml
from vemlight.runtime.wire import MAX_PART
from vemlight.runtime.wire_names import check_names
from vemlight.setting_keys import PATH
from vemlight.settings import Settings, SettingsSection
from vemlight.source_names import is_camera, is_live, is_path, shown_source

OPTIONS = {"error_percent": "--error", "controls": "--control"}  # of the command line, for keys whose option has another name
Section = TypeVar("Section", bound=SettingsSection)


def read_settings(path: Path | None) -> Settings:
    """The settings at `path` with absolute paths, or the defaults. Raises UserError naming file and key."""
    if path:
        _check_kind(path)
    settings = read_toml(path, Settings) if path else Settings()
    settings = _with_absolute_paths(settings, path.resolve().parent if path else Path.cwd())
    check_settings(settings, path)
    return settings


def _check_kind(path: Path) -> None:
    """Raises UserError for a source of light where the settings are expected, which is the likeliest mistake."""
    if path.is_dir() or is_camera(str(path)):
        found = "a folder" if path.is_dir() else "a camera"
    elif path.is_file() and path.suffix.lower() != ".toml":
        with open(path, "rb") as file:
            found = file_kind(file.read(BINARY_UNTIL))
    else:
        return
    if found:
        expected = 'a settings file (TOML) is expected here; write [capture] source = "' + str(path) + '" in one'
        raise UserError(f"{path}: is {found}, and {expected}, or play it with `vemlight run --source {path}`")


def _with_absolute_paths(section: Section, folder: Path) -> Section:
    """A copy whose paths, here and in the sections inside, start at `folder`."""
    changes: dict[str, Any] = {}
    for key, hint in get_type_hints(type(section), include_extras=True).items():
        value = getattr(section, key)
        if isinstance(value, SettingsSection):
            changes[key] = _with_absolute_paths(value, folder)
        elif value and PATH in get_args(hint):
            changes[key] = _absolute(folder, value) if isinstance(value, str) else tuple(_absolute(folder, each) for each in value)
    return msgspec.structs.replace(section, **changes)


def _absolute(folder: Path, value: str) -> str:
    """A path from `folder` on; the address of a stream and the name of a camera as they are."""
    return str(folder / value) if is_path(value) else value


def check_settings(settings: Settings, path: Path | None = None) -> None:
    """Raises UserError for values that each are legal but not together."""
    where = path or "settings"
    if settings.wire.transport == "tcp" and not settings.wire.keys and not settings.wire.insecure:
        raise UserError(f'{where}: [wire] transport = "tcp" has no keys; set keys = FOLDER (made by `vemlight keys`) or insecure = true')
    drawn, pixel_bytes = settings.renderer, 8 if settings.renderer.picture == "linear16" else 4
    if drawn.width * drawn.height * pixel_bytes > MAX_PART:
        most = f"more than the {MAX_PART // pixel_bytes} pixels that one message holds"
        raise UserError(f"{where}: [renderer] width, height: {drawn.width} x {drawn.height} is {most}; make them smaller")
    check_names(settings, where)
    if settings.rig.file:
        _check_rig(settings, where)
    if settings.mode == "lossless" and settings.fixtures.rig:
        way_out = "leave out rig, or write levels of a file of lights by `vemlight dmx --lights`"
        raise UserError(f'{where}: mode = "lossless" makes files, and [fixtures] rig drives lamps as it happens; {way_out}')
    for source in (settings.capture.source, settings.plate.source):
        if settings.mode == "lossless" and is_live(source):
            kind = "camera" if is_camera(source) else "stream"
            raise UserError(f'{where}: mode = "lossless" replays files and {shown_source(source)} is a {kind}; use mode = "live"')


def _check_rig(settings: Settings, where: Path | str) -> None:
    """Raises UserError for what a rig of cameras takes the place of, or cannot be with."""
    capture = settings.capture
    for key in ("source", "lens", "response", "ground", "masks", "exposures", "brackets", "recordings"):
        if getattr(capture, key):
            way_out = "the rig's file has it for each camera" if key in ("source", "lens", "response") else "it is for one camera"
            raise UserError(f"{where}: [capture] {key}: does not go with [rig] file: {way_out}; leave one of them out")
    if "capture" in settings.wire.names:
        raise UserError(f"{where}: [wire.names] capture: the rig's cameras have the names that its file gives them; leave it out")


def section_from_options(kind: type[Section], values: dict[str, Any]) -> Section:
    """A section made of a command's options; None stands for the default. Raises UserError naming the option as it is typed."""
    given = {key: str(value) if isinstance(value, Path) else value for key, value in values.items() if value is not None}
    try:
        return msgspec.convert(given, kind)
    except msgspec.ValidationError as error:
        text, _, where = str(error).partition(" - at `$.")
        if not where:  # values that do not go together; the text says how to fix them
            raise UserError(text) from error
        key, _, index = where.rstrip("`").partition("[")
        text = re.sub(r"^Expected `(float|int)` (?=[<>])", "must be ", text)
        if index:
            text = f"number {int(index.rstrip(']')) + 1} of it {text}"
        type_ = get_type_hints(kind).get(key)
        hint = f"choose from {', '.join(get_args(type_))}" if get_origin(type_) is Literal else "change that option"
        option = OPTIONS.get(key, f"--{key.replace('_', '-')}")
        raise UserError(f"{option}: {text[:1].lower()}{text[1:]}; {hint}") from error
