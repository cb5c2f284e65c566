"""The options that say how a source is to be read, which all commands that read one share, and the settings that they make."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import click

from vemlight.choices import LightOf, Matrix, Primaries, Projection, Range, Stereo
from vemlight.commands.parameters import PATH, Number
from vemlight.errors import UserError


class Numbers(click.ParamType):
    """So many finite numbers with commas between; 0: any number of them."""

    name = "numbers"

    def __init__(self, count: int) -> None:
        self._count = count

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "" and not self._count:
            return ()
        try:
            numbers = tuple(float(number) for number in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != (self._count or len(numbers) or 1) or not all(map(math.isfinite, numbers)):
            self.fail(f"{value[:40]} is not {self._count or 'a list of'} numbers; write them with commas between", param, ctx)
        return numbers


class Assignment(click.ParamType):
    """NAME=VALUE with a whole number."""

    name = "assignment"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        name, _, number = value.partition("=")
        if not (name and number.lstrip("-").isdecimal() and len(number) < 12):
            self.fail(f"{value[:40]} is not NAME=VALUE with a whole number; write it as gain=50", param, ctx)
        return name, int(number)


def _choice(kind: Any) -> click.Choice:
    return click.Choice(get_args(kind))


SOURCE_OPTIONS = (
    click.option("--lens", "lenses", type=PATH, multiple=True, help="Lens file of fisheye frames; once for each lens in the frame."),
    click.option("--response", type=PATH, help="Response file of raw frames."),
    click.option("--transfer", help="Curve of films, PNG, JPEG: srgb bt709 bt1886 pq hlg linear logc3 logc4 slog3 vlog acescct ocio:NAME."),
    click.option("--primaries", type=_choice(Primaries), help="Primaries of their colours; left out: as their tags say."),
    click.option("--matrix", type=_choice(Matrix), help="Matrix of their luma and chroma; left out: as their tags say."),
    click.option("--range", type=_choice(Range), help="Codes of black and white; left out: as their tags say."),
    click.option("--light", type=_choice(LightOf), help="hlg, bt709: light of the scene, or of the display."),
    click.option("--peak", type=Number(0, 100_000, min_open=True), help="Peak of an HLG display in cd/m2; left out: 1000."),
    click.option("--projection", type=_choice(Projection), help="Where pixels look; left out: fisheye with a lens, else equirect."),
    click.option("--span", type=Numbers(2), metavar="ACROSS,DOWN", help="equirect: degrees that the image covers; left out: 360,180."),
    click.option("--control", "controls", type=Assignment(), multiple=True, help="Cameras: NAME=VALUE of a control; as often as needed."),
    click.option("--format", help="Cameras: pixel format by the kernel's letters, such as YUYV, or GenICam's name. PNG: its mosaic."),
    click.option("--exposures", type=Numbers(0), metavar="S,S,..", help="Cameras: exposures to take in turn and to merge, in seconds."),
    click.option("--exposure-control", help="Cameras: the control that sets them; left out: exposure_time_absolute."),
    click.option("--brackets", is_flag=True, default=None, help="Folders of photographs: several exposures, by EXIF, are one frame."),
    click.option("--meter-lux", type=Number(0, 1e6), help="Level light meter's reading, lux: clipped light is estimated by it."),
    click.option("--stereo", type=_choice(Stereo), help="Films for two eyes: how they lie; the first is taken."),
    click.option("--ground", type=Number(0, 1), help="Albedo of a ground below the horizon, which sends light up; left out: none."),
    click.option("--masks", type=PATH, help="Settings file whose [[capture.masks]] leave regions out of the map, as the page saves one."),
)
CAPTURE_KEYS = (
    "transfer", "primaries", "matrix", "range", "light", "peak", "projection", "span", "stereo", "format", "ground", "brackets",
    "exposures", "exposure_control", "meter_lux", "masks",
)  # fmt: skip


def source_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Adds SOURCE_OPTIONS to a command."""
    for option in reversed(SOURCE_OPTIONS):
        command = option(command)
    return command


def capture_settings(capture: Any, source: str | None, given: dict[str, Any]) -> Any:
    """The settings' section with what a command's options say instead; None and () were left out. Raises UserError.

    source: a path from the working folder, an address, or a camera's name. given: by the names of SOURCE_OPTIONS and of [capture] keys.
    """
    import msgspec

    from vemlight.settings import Capture
    from vemlight.settings_file import read_settings, section_from_options
    from vemlight.source_names import is_path

    values = msgspec.structs.asdict(capture)
    if source == "":
        raise UserError("the source is an empty name; name a file, a folder, a camera or a stream")
    if source is not None:
        values["source"] = str(Path.cwd() / source) if is_path(source) else source
    lenses, response = given.pop("lenses", ()), given.pop("response", None)
    if lenses:
        names = [str(Path.cwd() / lens) for lens in lenses]
        values["lens"] = names[0] if len(names) == 1 else tuple(names)
    if controls := given.pop("controls", ()):
        values["controls"] = {**values["controls"], **dict(controls)}
    if masks := given.pop("masks", None):
        values["masks"] = read_settings(masks).capture.masks
        if not values["masks"]:
            raise UserError(f"{masks}: has no [[capture.masks]]; draw some on the page of a run and save them as settings")
    if response:
        values["response"] = str(Path.cwd() / response)
    return section_from_options(Capture, values | {key: value for key, value in given.items() if value is not None})


def frames_of_live(frames: int | None, source: str) -> int:
    """How many frames of a camera or stream a command is to take. Raises UserError where none is said: they have no end."""
    from vemlight.source_names import shown_source

    if not frames:
        raise UserError(f"{shown_source(source)}: has no last frame; say how many: --frames N")
    return frames
