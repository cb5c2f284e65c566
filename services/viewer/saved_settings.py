"""What is seen, as a settings file: a run with it gives the same pictures as the settings in use with what was chosen on the page."""

import re
from pathlib import Path
from typing import Any

import msgspec
import tomli_w

from vemlight.runtime import wire
from vemlight.runtime.session import session_folder
from vemlight.settings import Capture, Settings, chosen_capture
from vemlight.source_names import is_live, shown_source

HEAD = "# What the page of vemlight showed when this was saved. `vemlight run` with this file shows the same.\n"
MAX_SPEED = 100.0  # that settings take
NUMBERS = re.compile(r"\[\n(?:\s+[-+.\deE]+,\n)+\s*\]")  # a list of numbers, which tomli_w writes one a line


def saved_settings(settings: Settings, control: wire.ControlMessage, source: wire.SourceMessage | None = None) -> Settings:
    """The settings with the choices in them. Pause is none of them, nor are armed fixtures: those wait for a person.

    source: what the capture says of the one that plays, without which a range in seconds is not known in frames.
    """
    sampler, renderer = settings.sampler, settings.renderer
    capture = _played(settings.capture, control.source) or settings.capture
    masks, speed = capture.masks if control.masks is None else control.masks, capture.speed * (control.speed or 1.0)
    capture = msgspec.structs.replace(capture, masks=masks, speed=min(speed, MAX_SPEED))
    if frames := _range(capture, control, source):
        capture = msgspec.structs.replace(capture, start=frames.start, end=frames.stop)
    sampler = msgspec.structs.replace(
        sampler,
        count=control.count or sampler.count,
        filter="none" if control.filtered is False else sampler.filter,
        lamp=sampler.lamp if control.lamps is None else control.lamps,
    )
    poses = {pose.name: pose for pose in (*renderer.poses, *control.poses)}
    exposure = renderer.exposure if control.exposure is None else control.exposure
    camera = renderer.camera if control.camera is None or control.scene else control.camera
    renderer = msgspec.structs.replace(renderer, exposure=exposure, poses=tuple(poses.values()), camera=camera)
    return msgspec.structs.replace(settings, capture=capture, sampler=sampler, renderer=renderer)


def _played(own: Capture, choice: str | None) -> Capture | None:
    """The section for a source that was chosen; None for one that ends with this run, or whose name is none."""
    kind, _, name = (choice or "").partition(" ")
    if kind == "bundled" and not name:
        return chosen_capture(own, "")
    if Path(name).name != name or name in ("", ".."):
        return None
    if kind == "recording" and own.recordings:
        return msgspec.structs.replace(chosen_capture(own, str(Path(own.recordings) / name)), recordings=own.recordings)
    if kind == "camera":
        same_kind = own if is_live(own.source) else chosen_capture(own, "")
        return msgspec.structs.replace(same_kind, source=f"/dev/{name}", record="", brackets=False)
    return None


def _range(saved: Capture, control: wire.ControlMessage, source: wire.SourceMessage | None) -> range | None:
    """The frames, as `[capture]` counts them, of a range that was chosen; None where there is none, or of another source than is saved."""
    chosen = control.in_s is not None or control.out_s is not None
    lasts = control.source is None or _played(saved, control.source) is not None
    if not (chosen and lasts and source and source.choice == control.source and source.frames):
        return None
    last = source.frames - 1
    first = 0 if control.in_s is None else min(round(control.in_s * source.fps), last)
    final = last if control.out_s is None else min(round(control.out_s * source.fps), last)
    return range(saved.start + first, saved.start + max(first, final) + 1)


def settings_file(settings: Settings, control: wire.ControlMessage, source: wire.SourceMessage | None = None) -> bytes:
    """The TOML text of `saved_settings`, with a line for each thing that is left out of it because it is secret, or this run's own."""
    saved, left_out = saved_settings(settings, control, source), []
    if saved.viewer.token:
        saved = msgspec.structs.replace(saved, viewer=msgspec.structs.replace(saved.viewer, token=""))
        left_out.append("# Left out: [viewer] token, which opens the page. Without one a new one is made where one is needed.\n")
    if control.source is not None and _played(settings.capture, control.source) is None:
        left_out.append("# Left out: the source that was chosen, which ends with that run. [capture] source is the one before it.\n")
    if (control.in_s is not None or control.out_s is not None) and _range(saved.capture, control, source) is None:
        left_out.append("# Left out: the range that was played, of a source that is not in here. [capture] start and end name frames.\n")
    if control.loop is False:
        left_out.append("# Left out: that it was played once. A run plays its frames again and again; [capture] frames ends it.\n")
    if control.scene is not None:
        left_out.append("# Left out: the scene that was dropped, which ends with that run. [renderer] scene is the one before it.\n")
    for section in ("capture", "plate"):
        part = getattr(saved, section)
        if (shown := shown_source(part.source)) != part.source:
            saved = msgspec.structs.replace(saved, **{section: msgspec.structs.replace(part, source=shown)})
            left_out.append(f"# Left out: user, password and query of [{section}] source. Add them to the address if it needs them.\n")
    session = session_folder()
    if session is not None and saved.wire.folder == str(session.parent):  # made by this run and gone with it; any other is shared with runs
        saved = msgspec.structs.replace(saved, wire=msgspec.structs.replace(saved.wire, folder=""))
    sections = {key: value for key, value in _without_null(msgspec.to_builtins(saved)).items() if value != {}}
    text = NUMBERS.sub(lambda found: " ".join(found[0].split()).replace("[ ", "[").replace(", ]", "]"), tomli_w.dumps(sections))
    return (HEAD + "".join(left_out) + "\n" + text).encode()


def _without_null(value: Any) -> Any:
    """The value without keys that have none: TOML has no word for that."""
    if isinstance(value, dict):
        return {key: _without_null(each) for key, each in value.items() if each is not None}
    return [_without_null(each) for each in value] if isinstance(value, list | tuple) else value
