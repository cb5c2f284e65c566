"""The commands that hand lights to other programs."""

import sys
from pathlib import Path
from typing import Any

import click

from vemlight.commands.offline_commands import options_of_making, sampling
from vemlight.commands.options import ExportOptions
from vemlight.commands.parameters import PATH, Number, OutFile
from vemlight.commands.report import Report, reporting
from vemlight.errors import UserError


@click.command()
@sampling
@click.option("--error", "error_percent", type=Number(0, 100, min_open=True), help="Error limit, %; as few lights as keep it are used.")
@click.option("--soft/--points", default=None, help="Lights with the extent of their light, the default of tracked lights, or points.")
@click.option("--usd", type=OutFile(".usda", ".usdc"), help="OUT.usda or .usdc: all frames, a DistantLight for each id.")
@click.option("--usd-dialect", type=click.Choice(["standard", "blender"]), default="standard", show_default=True,
              help="blender: what Blender's importer multiplies is divided before; it reads the first frame alone.")  # fmt: skip
@click.option("--residual", is_flag=True, help="USD, of a map: distant lights for compact sources only, the rest as a DomeLight.")
@click.option("--gltf", type=OutFile(".gltf", ".glb"), help="OUT.gltf or .glb: one frame, KHR_lights_punctual.")
@click.option("--frame", type=click.IntRange(0), default=0, show_default=True, help="glTF: which frame, from 0.")
@click.option("--mcap", type=OutFile(".mcap"), help="OUT.mcap: all frames as JSON on the channel /lights.")
@reporting
@click.pass_context
def export(context: click.Context, **values: Any) -> Report:
    """Write lights, or those of a map or a sequence, as USD, glTF or MCAP for other programs."""
    from vemlight.commands.export import export_lights

    return export_lights(ExportOptions(**values, given=options_of_making(context)))


@click.command()
@click.argument("settings", type=PATH, required=False)
@click.option("--osc", metavar="HOST:PORT", help="Open Sound Control over UDP to HOST:PORT.")
@click.option("--jsonl", metavar="HOST:PORT", help="One line of JSON a frame to HOST:PORT, where a program listens on tcp.")
def stream(settings: Path | None, osc: str | None, jsonl: str | None) -> None:
    """Send the lights of running services to another program, as they come."""
    from vemlight.exchange.stream import destination
    from vemlight.exchange.stream import stream as send
    from vemlight.settings_file import read_settings

    if not (osc or jsonl):
        raise UserError("--osc, --jsonl: none is given; name a HOST:PORT to send to")
    to_osc, to_jsonl = (destination(text, option) if text else None for text, option in ((osc, "--osc"), (jsonl, "--jsonl")))
    send(read_settings(settings), to_osc, to_jsonl)


@click.command()
@click.argument("service", type=click.Choice(["sampler"]))
@click.argument("settings", type=PATH, required=False)
@click.option("--listen", metavar="HOST:PORT", required=True, help="Where listeners connect: 0.0.0.0:5702 for all networks.")
@click.option("--count", type=click.IntRange(1, 100_000), help="Lights of a frame at most, for slow links; the others join the nearest.")
@click.option("--bytes", "max_bytes", type=click.IntRange(1), default=6000, show_default=True, help="Of a frame at most.")
@click.option("--rate", type=Number(0, 1000, min_open=True), help="Frames a second at most; left out: all.")
def relay(service: str, settings: Path | None, listen: str, count: int | None, max_bytes: int, rate: float | None) -> None:
    """Publish the lights of running services to many listeners."""
    from vemlight.exchange.relay import Feed
    from vemlight.exchange.relay import relay as publish
    from vemlight.exchange.stream import destination
    from vemlight.settings_file import read_settings

    sys.exit(publish(read_settings(settings), destination(listen, "--listen"), Feed(count, max_bytes, rate)))


COMMANDS = (export, stream, relay)
