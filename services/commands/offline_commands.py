"""The commands that light and render files in one process, and that chart the methods on them."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from vemlight.commands.options import ArchiveOptions, LightsOptions, LocateOptions, RenderOptions, SamplingOptions, options_as
from vemlight.commands.parameters import (
    BACKGROUND,
    EXR_FLOATS,
    FILTER,
    METHOD,
    PATH,
    SHADOWS,
    TONE,
    Number,
    OutFile,
    OutFolder,
    width_height,
)
from vemlight.commands.report import Report, reporting
from vemlight.commands.source_options import Numbers, source_options

SAMPLING = (
    click.argument("source"),
    click.option("--count", type=click.IntRange(1, 100_000), help="Lights a frame; left out: 72. With --error their maximum: 256."),
    click.option("--method", type=METHOD, help="How lights are chosen; left out: tracked."),
    click.option("--coverage", type=click.Choice(["hemisphere", "sphere"]), default="hemisphere", show_default=True),
    click.option("--filter", type=FILTER, help="Temporal filter; left out: the method's own, and none for a single map."),
    click.option("--deflicker/--no-deflicker", default=None, help="Remove the mains flicker of lamps where it is found; the default."),
    click.option("--fps", type=Number(0, 1000, min_open=True), help="Frames a second, where the source does not say."),
    click.option("--frames", type=click.IntRange(1), help="Number of frames; left out: all. A camera or a stream needs it."),
    click.option("--layer", help="Of EXR files with several layers or parts; left out: the picture itself."),
)


def sampling(command: Callable[..., None]) -> Callable[..., None]:
    """Adds the parameters of SamplingOptions to a command."""
    command = source_options(command)
    for parameter in reversed(SAMPLING):
        command = parameter(command)
    return command


def options_of_making(context: click.Context) -> tuple[str, ...]:
    """Those options that say how lights are made, as they were typed."""
    of_making = {*SamplingOptions.__struct_fields__, "error_percent", "soft"} - {"source", "frames"}
    return tuple(
        max(parameter.opts, key=len)
        for parameter in context.command.params
        if parameter.name in of_making and context.get_parameter_source(parameter.name) is click.core.ParameterSource.COMMANDLINE
    )


def of_lights(command: Callable[..., None]) -> Callable[..., None]:
    """Adds the options of commands that write lights as they are."""
    for option in reversed((
        click.option("--clusters", type=click.IntRange(1, 100_000), help="Maximum number of lights after merging neighbours."),
        click.option("--error", "error_percent", type=Number(0, 100, min_open=True), help="Error limit, %; as few lights as keep it."),
        click.option("--soft/--points", default=None,
                     help="Lights with the extent of their light (vemlight.lights/2), the default of tracked lights, or points."),
    )):  # fmt: skip
        command = option(command)
    return command


@click.command()
@sampling
@of_lights
@click.option("--score", is_flag=True, help="Print the lights' error and flicker.")
@click.option("--out", type=OutFile(".json", ".jsonl", dash=True), required=True,
              help="LIGHTS.json for one frame, LIGHTS.jsonl for any number; - for standard output.")  # fmt: skip
@reporting
@options_as(LightsOptions)
def lights(options: LightsOptions) -> Report:
    """Write the lights of a map or a sequence."""
    from vemlight.commands.offline import write_lights_file

    return write_lights_file(options)


@click.command()
@sampling
@of_lights
@click.option("--workers", type=click.IntRange(1, 256), help="Processes that make maps; left out: one a processor, at most 8.")
@click.option("--chunk", type=click.IntRange(1), metavar="FRAMES", help="Frames of a chunk; left out: 32 MB of maps, or as begun.")
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Have the workers of this Dask scheduler make the maps (vemlight[dask]).")
@click.option("--maps-only", is_flag=True, help="Make maps, no lights, so that several machines share the chunks.")
@click.option("--from-maps", is_flag=True, help="Make lights of the maps that are there.")
@click.option("--index", type=click.IntRange(0), help="--maps-only: which of --indices this is; left out: $JOB_COMPLETION_INDEX, or 0.")
@click.option("--indices", type=click.IntRange(1), help="--maps-only: how many share the chunks, each every so many; left out: 1.")
@click.option("--out", type=OutFolder(), required=True, help="Folder of the archive; the same command goes on where it was cut off.")
@reporting
@options_as(ArchiveOptions)
def archive(options: ArchiveOptions) -> Report:
    """Write the lights of a long recording: with several processes, resumable, in bounded memory; the bytes are those of `lights`."""
    from vemlight.commands.archive.archiving import archive as archived
    from vemlight.commands.archive.index import with_index_of_job

    return archived(with_index_of_job(options, os.environ))


@click.command()
@sampling
@click.option("--scene", type=PATH, help="Scene file; left out: the bundled scene.")
@click.option("--size", metavar="WIDTHxHEIGHT", default="640x480", show_default=True, callback=width_height, help="Picture size in pixels.")
@click.option("--exposure", type=Number(-20, 20), default=0.0, show_default=True, help="Exposure of PNG and video, in stops.")
@click.option("--tone", type=TONE, default="reinhard", show_default=True, help="Tone mapping of PNG and video.")
@click.option("--background", type=BACKGROUND, default="clear", show_default=True, help="What is behind the scene: nothing, or the map.")
@click.option("--bounces", type=click.IntRange(0, 1), default=1, show_default=True, help="Of light from surface to surface.")
@click.option("--shadows", type=SHADOWS, default="auto", show_default=True, help="By rays or by maps; auto: by rays without a GPU.")
@click.option("--shadow-map", type=click.IntRange(16, 4096), help="Texels on a side for each light; left out: by the light's power.")
@click.option("--exr", type=EXR_FLOATS, default="half", show_default=True, help="Numbers of an EXR: halves, or 32-bit floats.")
@click.option("--video", type=OutFile(".mp4", ".mov", ".mkv"), help="VIDEO.mp4, .mov or .mkv of all frames, with --out or instead of it.")
@click.option("--out", type=OutFile(".exr", ".png"), help="IMAGE.exr (linear) or IMAGE.png (tone-mapped); a sequence is numbered.")
@click.pass_context
def render(context: click.Context, **values: Any) -> None:
    """Render a scene under the light of a map or a sequence, or under lights from a file."""
    from vemlight.commands.rendering import write_pictures

    click.echo(write_pictures(RenderOptions(**values, given=options_of_making(context))))


@click.command()
@click.argument("maps", nargs=-1, required=True, type=PATH, metavar="MAP...")
@click.option("--out", type=OutFolder(), required=True, help="Folder for the charts and their numbers.")
@reporting
def chart(maps: tuple[Path, ...], out: Path) -> Report:
    """Chart error, flicker and time of each method on your own maps."""
    from vemlight.commands.chart import chart as draw

    written = [path.name for path in draw(list(maps), out)]
    return Report(f"{out}: {', '.join(written)}", {"out": str(out), "files": written})


@click.command()
@click.argument("rig", type=PATH)
@click.option("--out", type=OutFile(".json", ".jsonl"), required=True, help="LIGHTS.json for one moment, LIGHTS.jsonl for any number.")
@click.option("--subject", type=Numbers(3), metavar="X,Y,Z", help="Place, m, whose light is wanted: nearer cameras count more there.")
@click.option("--count", type=click.IntRange(1, 100_000), help="Directional lights a frame; left out: 72. With --error their maximum: 256.")
@click.option("--error", "error_percent", type=Number(0, 100, min_open=True), help="Error limit, %; as few lights as keep it are used.")
@click.option("--soft/--points", default=None, help="Directional lights with the extent of their light, the default, or points.")
@click.option("--coverage", type=click.Choice(["hemisphere", "sphere"]), default="hemisphere", show_default=True, help="Of each camera.")
@click.option("--fps", type=Number(0, 1000, min_open=True), help="Frames a second, where the recordings do not say.")
@click.option("--frames", type=click.IntRange(1), help="Number of frames; left out: all.")
@reporting
@options_as(LocateOptions)
def locate(options: LocateOptions) -> Report:
    """Locate near lights by the recordings of several cameras; RIG.toml says where each stands. The rest stays directional lights."""
    from vemlight.commands.locate import write_located

    return write_located(options)


COMMANDS = (lights, archive, render, locate, chart)
