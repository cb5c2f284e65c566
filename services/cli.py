"""The command `vemlight`. Each command loads what it needs when it runs, so that `vemlight --help` answers at once."""

import sys
from pathlib import Path
from typing import Any

import click

from services.files import BadInput

EXISTING = click.Path(path_type=Path)


class Command(click.Group):
    """Turns what the user must mend into one line on stderr and status 2."""

    def invoke(self, context: click.Context) -> Any:
        try:
            return super().invoke(context)
        except BadInput as error:
            print(f"vemlight: {error}", file=sys.stderr)
            context.exit(2)
        except OSError as error:
            print(f"vemlight: {error.filename or ''}: {error.strerror or error}; check the path and the disk", file=sys.stderr)
            context.exit(2)


@click.group(cls=Command, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="vemlight")
def main() -> None:
    """Live image-based lighting: frames of a fisheye HDR camera become a few steady directional lights, and a lit picture."""


@main.command()
@click.argument("settings", type=EXISTING, required=False)
@click.option("--frames", type=click.IntRange(1), help="Stop after so many frames.")
@click.option("--out", type=EXISTING, help="Folder for the lights (.jsonl), the pictures (EXR and PNG) and a contact sheet.")
@click.option("--mode", type=click.Choice(["live", "lossless"]), help="live: the newest frame wins; lossless (with --out): every frame.")
def run(settings: Path | None, frames: int | None, out: Path | None, mode: str | None) -> None:
    """Start capture, sampler, renderer and viewer, and watch over them."""
    import msgspec

    from services.settings import check_settings, read_settings
    from services.supervise import supervise

    wanted = read_settings(settings)
    if frames:
        wanted = msgspec.structs.replace(wanted, capture=msgspec.structs.replace(wanted.capture, frames=frames))
    if out:
        wanted = msgspec.structs.replace(wanted, out=str(out.resolve()), mode="lossless")
    if mode:
        wanted = msgspec.structs.replace(wanted, mode=mode)
    check_settings(wanted, settings)
    sys.exit(supervise(wanted))


def _service(name: str, summary: str) -> None:
    @main.command(name, help=summary)
    @click.argument("settings", type=EXISTING, required=False)
    def command(settings: Path | None) -> None:
        from importlib import import_module

        from services.start import start

        sys.exit(start(import_module(f"services.{name}.__main__").main, [str(settings)] if settings else []))


_service("capture", "One service: frames of a recording or a camera become polar maps.")
_service("sampler", "One service: polar maps become lights.")
_service("renderer", "One service: lights become pictures of the scene.")
_service("viewer", "One service: the page that shows it all.")


@main.command()
@click.argument("source", type=EXISTING)
@click.option("--count", type=click.IntRange(1, 100_000), default=72, show_default=True, help="Lights a frame.")
@click.option("--method", help="How lights are chosen.")
@click.option("--coverage", type=click.Choice(["hemisphere", "sphere"]), default="hemisphere", show_default=True)
@click.option("--filter", "filter_", help="Temporal filter, or none. One map alone needs none.")
@click.option("--fps", type=click.FloatRange(0, 1000, min_open=True), help="Frames a second, where the source does not say.")
@click.option("--lens", type=EXISTING, help="Lens file of fisheye frames.")
@click.option("--response", type=EXISTING, help="Response file of raw frames.")
@click.option("--out", type=EXISTING, required=True, help="LIGHTS.json for one frame, LIGHTS.jsonl for any number.")
def lights(source: Path, out: Path, **options: Any) -> None:
    """Write the lights of a map or a sequence."""
    from services.offline import write_lights_of

    write_lights_of(source, out, **options)


@main.command()
@click.argument("source", type=EXISTING)
@click.option("--scene", type=EXISTING, help="Scene file; left out: the bundled scene.")
@click.option("--count", type=click.IntRange(1, 100_000), default=72, show_default=True, help="Lights a frame.")
@click.option("--size", default="640x480", show_default=True, help="WIDTHxHEIGHT in pixels.")
@click.option("--method", help="How lights are chosen.")
@click.option("--coverage", type=click.Choice(["hemisphere", "sphere"]), default="hemisphere", show_default=True)
@click.option("--filter", "filter_", help="Temporal filter, or none. One map alone needs none.")
@click.option("--fps", type=click.FloatRange(0, 1000, min_open=True), help="Frames a second, where the source does not say.")
@click.option("--lens", type=EXISTING, help="Lens file of fisheye frames.")
@click.option("--response", type=EXISTING, help="Response file of raw frames.")
@click.option("--exposure", type=click.FloatRange(-20, 20), default=0.0, show_default=True, help="Stops, for the PNG.")
@click.option("--out", type=EXISTING, required=True, help="IMAGE.exr (linear) or IMAGE.png (tone-mapped); a sequence is numbered.")
def render(source: Path, scene: Path | None, size: str, exposure: float, out: Path, **options: Any) -> None:
    """Render a scene under the light of a map or a sequence."""
    from services.offline import write_pictures_of

    write_pictures_of(source, scene, size, exposure, out, **options)
