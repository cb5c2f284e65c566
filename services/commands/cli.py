"""The command `vemlight`. Each command loads what it needs when it runs, so that `vemlight --help` answers at once."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from vemlight.errors import FatalError, UserError
from vemlight.runtime.channels import SERVICES

EXISTING = click.Path(path_type=Path)


class Command(click.Group):
    """Turns what the user must mend into one line on stderr and status 2, what only a new start may mend into one and status 1."""

    def invoke(self, context: click.Context) -> Any:
        try:
            return super().invoke(context)
        except UserError as error:
            print(f"vemlight: {error}", file=sys.stderr)
            context.exit(2)
        except FatalError as error:
            print(f"vemlight: {error}", file=sys.stderr)
            context.exit(1)
        except BrokenPipeError:  # `| head` has read enough
            raise
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

    from vemlight.runtime.supervise import supervise
    from vemlight.settings import check_settings, read_settings

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

        from vemlight.runtime.start import start

        sys.exit(start(import_module(f"vemlight.{name}.__main__").main, [str(settings)] if settings else []))


_service("capture", "One service: frames of a recording or a camera become polar maps.")
_service("sampler", "One service: polar maps become lights.")
_service("renderer", "One service: lights become pictures of the scene.")
_service("viewer", "One service: the page that shows it all.")
_service("plate", "One service: a second camera's picture behind the scene.")


# What `lights` and `render` both ask of a source and of its lights.
SAMPLING = (
    click.option("--count", type=click.IntRange(1, 100_000), default=72, show_default=True, help="Lights a frame."),
    click.option("--method", help="How lights are chosen."),
    click.option("--coverage", type=click.Choice(["hemisphere", "sphere"]), default="hemisphere", show_default=True),
    click.option("--filter", "filter_", help="Temporal filter, or none. One map alone needs none."),
    click.option("--deflicker", is_flag=True, help="Take the mains flicker of lamps out of the light."),
    click.option("--fps", type=click.FloatRange(0, 1000, min_open=True), help="Frames a second, where the source does not say."),
    click.option("--lens", type=EXISTING, help="Lens file of fisheye frames."),
    click.option("--response", type=EXISTING, help="Response file of raw frames."),
)


def sampling(command: Callable[..., None]) -> Callable[..., None]:
    """Adds the options in SAMPLING to a command."""
    for option in reversed(SAMPLING):
        command = option(command)
    return command


@main.command()
@click.argument("source", type=EXISTING)
@sampling
@click.option("--clusters", type=click.IntRange(1, 100_000), help="Most lights after merging neighbours.")
@click.option("--error", type=click.FloatRange(0, 100, min_open=True), help="Per cent: as few lights as keep the irradiance within it.")
@click.option("--score", is_flag=True, help="Print how true and how steady the lights are.")
@click.option("--out", type=EXISTING, required=True, help="LIGHTS.json for one frame, LIGHTS.jsonl for any number.")
def lights(source: Path, out: Path, **options: Any) -> None:
    """Write the lights of a map or a sequence."""
    from vemlight.commands.offline import write_lights_of

    click.echo(write_lights_of(source, out, **options))


@main.command()
@click.argument("source", type=EXISTING)
@sampling
@click.option("--scene", type=EXISTING, help="Scene file; left out: the bundled scene.")
@click.option("--size", default="640x480", show_default=True, help="WIDTHxHEIGHT in pixels.")
@click.option("--exposure", type=click.FloatRange(-20, 20), default=0.0, show_default=True, help="Stops, for the PNG.")
@click.option("--tone", type=click.Choice(["reinhard", "exponential"]), default="reinhard", show_default=True, help="Curve of the PNG.")
@click.option("--background", type=click.Choice(["clear", "map"]), default="clear", show_default=True, help="Behind the scene.")
@click.option("--gloss-lights", type=click.IntRange(0, 100_000), help="Lights in the set for glossy surfaces; left out: 512 for any.")
@click.option("--shadow-map", type=click.IntRange(16, 4096), help="Texels on a side for each light; left out: by its share of the power.")
@click.option("--video", type=EXISTING, help="VIDEO.mp4, .mov or .mkv of all frames, with --out or instead of it.")
@click.option("--out", type=EXISTING, help="IMAGE.exr (linear) or IMAGE.png (tone-mapped); a sequence is numbered.")
def render(source: Path, scene: Path | None, size: str, exposure: float, out: Path | None, **options: Any) -> None:
    """Render a scene under the light of a map or a sequence."""
    from vemlight.commands.offline import write_pictures_of

    click.echo(write_pictures_of(source, scene, size, exposure, out, **options))


@main.command()
@click.argument("maps", nargs=-1, required=True, metavar="MAP...")
@click.option("--lens", type=EXISTING, required=True, help="Lens file of the camera to play.")
@click.option("--response", type=EXISTING, help="Response file; left out: radiance instead of raw codes.")
@click.option("--out", type=EXISTING, required=True, help="Folder for the frames and, beside them, the truth.")
@click.option("--frames", type=click.IntRange(1), help="How many; left out: one for each map.")
@click.option("--fps", type=click.FloatRange(0, 1000, min_open=True), default=25.0, show_default=True)
@click.option("--rotate", type=float, default=0.0, show_default=True, help="Degrees a frame, about the vertical.")
@click.option("--keyframes", type=EXISTING, help="Motion instead: TOML of [[key]] time_s, rotate_deg = [x, y, z].")
@click.option("--noise", type=click.FloatRange(0), default=0.0, show_default=True, help="Noise in code steps (sigma).")
@click.option("--pattern", type=click.FloatRange(0), default=0.0, show_default=True, help="Fixed pattern noise in code steps (sigma).")
@click.option("--mosaic", type=click.Choice(["mono", "RGGB", "GRBG", "GBRG", "BGGR"]), help="One value a pixel; left out: three.")
@click.option("--exposure", type=click.FloatRange(0), default=0.0, show_default=True, help="Seconds, against mains flicker.")
@click.option("--flicker", type=click.FloatRange(0), default=0.0, show_default=True, help="Hz of the light: 100 or 120 for mains.")
@click.option("--dropouts", type=click.FloatRange(0, 1), default=0.0, show_default=True, help="Share of frames that get lost.")
@click.option("--truth", is_flag=True, help="Write the true radiance of each frame, too.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
def simulate(maps: tuple[str, ...], lens: Path, response: Path | None, out: Path, **options: Any) -> None:
    """The virtual camera: lat-long maps (or a scene of its own: sky, interior) in, raw fisheye frames out."""
    from vemlight.capture.lens import read_lens
    from vemlight.capture.response import read_response
    from vemlight.capture.simulation.virtual_camera import simulate as take

    take(
        list(maps),
        read_lens(lens),
        read_response(response) if response else None,
        out,
        frames=options["frames"] or 0,
        fps=options["fps"],
        rotate_deg_per_frame=options["rotate"],
        keyframes=options["keyframes"],
        noise_codes=options["noise"],
        pattern_codes=options["pattern"],
        mosaic=options["mosaic"],
        exposure_s=options["exposure"],
        flicker_hz=options["flicker"],
        dropouts=options["dropouts"],
        truth_maps=options["truth"],
        seed=options["seed"],
    )
    click.echo(f"{out}: the frames, their lens.toml, and the truth in truth.jsonl")


@main.group()
def calibrate() -> None:
    """Find what your camera's lens and sensor do."""


@calibrate.command()
@click.argument("images", nargs=-1, required=True, type=EXISTING, metavar="IMAGE...")
@click.option("--board", required=True, help="Inner corners, COLUMNSxROWS, such as 8x6.")
@click.option("--square", type=click.FloatRange(0, 10, min_open=True), required=True, help="Side of a square in metres.")
@click.option("--dictionary", default="", help="ChArUco board: OpenCV's name of its markers, such as DICT_4X4_50.")
@click.option("--marker", type=click.FloatRange(0, 10), default=0.0, help="ChArUco board: side of a marker in metres.")
@click.option("--rim", type=click.FloatRange(0, 180), default=0.0, help="Degrees off the axis where the image ends; 0: found.")
@click.option("--accept", is_flag=True, help="Take a lens that fits its corners badly.")
@click.option("--picture", type=EXISTING, help="PNG of coverage and residuals; left out: beside the lens file.")
@click.option("--out", type=EXISTING, required=True, help="LENS.toml")
def lens(images: tuple[Path, ...], board: str, square: float, out: Path, **options: Any) -> None:
    """Find the lens from photographs of a chessboard."""
    from vemlight.capture.calibration.boards import Board
    from vemlight.capture.calibration.lens_fit import calibrate_lens, lens_summary

    columns, _, rows = board.partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise UserError(f"--board {board}: is not COLUMNSxROWS; write it as 8x6")
    wanted = Board((int(columns), int(rows)), square, options["dictionary"], options["marker"])
    picture = options["picture"] or out.with_suffix(".png")
    report = calibrate_lens(list(images), wanted, out, rim_deg=options["rim"], accept=options["accept"], picture=picture)
    click.echo(f"{lens_summary(report)}\nsee {picture}")


@calibrate.command()
@click.argument("patches", type=EXISTING)
@click.option("--kind", type=click.Choice(["log", "companding", "linear", "srgb"]), default="log", show_default=True)
@click.option("--bits", type=click.IntRange(1, 16), help="Of a code; left out: the fewest of 8, 10, 12, 14, 16 that hold them.")
@click.option("--accept", is_flag=True, help="Take an error above 5 % at a check patch.")
@click.option("--white", type=click.FloatRange(0, min_open=True), help="PATCHES is a frame of a ColorChecker: cd/m2 of its white patch.")
@click.option("--corners", help="Where it is, left out: found. Pixels of dark skin, bluish green, black, white: x,y,x,y,x,y,x,y.")
@click.option("--picture", type=EXISTING, help="PNG of the fit; left out: beside the response file.")
@click.option("--out", type=EXISTING, required=True, help="RESPONSE.toml")
def response(patches: Path, kind: Any, bits: int | None, accept: bool, out: Path, **options: Any) -> None:
    """Find the sensor's response from patches of known luminance (CSV: code, luminance, use = fit or check)."""
    from vemlight.capture.calibration.response_fit import calibrate_response, read_patches, response_summary

    in_frame = options["corners"] or options["white"]
    read = _chart(patches, options["corners"], options["white"]) if in_frame else read_patches(patches)
    picture = options["picture"] or out.with_suffix(".png")
    report = calibrate_response(read, out, kind=kind, bits=bits or 0, accept=accept, picture=picture)
    click.echo(f"{response_summary(report)}\nsee {picture}")


def _chart(frame: Path, corners: str | None, white: float | None) -> list[Any]:
    from vemlight.capture.calibration.colorchecker import chart_from_corners, find_chart
    from vemlight.capture.calibration.response_fit import gray_patches
    from vemlight.light.images import read_codes

    if not white:
        raise UserError("--corners: needs --white, the luminance of the white patch")
    codes = read_codes(frame)
    if not corners:
        return gray_patches(codes, find_chart(codes), white)
    try:
        numbers = [float(number) for number in corners.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 8:
        raise UserError("--corners: needs eight numbers, x,y,x,y,x,y,x,y")
    return gray_patches(codes, chart_from_corners(list(zip(numbers[::2], numbers[1::2], strict=True))), white)


@main.command()
@click.argument("settings", type=EXISTING, required=False)
@click.option("--source", help="Instead of the settings' source: a file, a folder, or /dev/videoN.")
@click.option("--frames", type=click.IntRange(1), help="How many; left out: all that there are, or until Ctrl-C.")
@click.option("--out", type=EXISTING, required=True, help="Folder for the recording.")
def record(settings: Path | None, source: str | None, frames: int | None, out: Path) -> None:
    """Record a camera's raw frames, or a file source as polar maps, with all that is known in the headers."""
    import msgspec

    from vemlight.capture.source import record as run
    from vemlight.settings import read_settings

    wanted = msgspec.structs.replace(read_settings(settings).capture, record=str(out))
    if source:
        wanted = msgspec.structs.replace(wanted, source=str(Path.cwd() / source))
    done = run(wanted, frames or 0)
    click.echo(f"{done.written} frames are in {out}; {done.dropped} dropped, {done.failed} refused by the disk")
    if done.trouble:
        raise UserError(done.trouble)


@main.command()
@click.argument("frame", type=EXISTING)
@click.option("--lens", type=EXISTING, required=True)
@click.option("--response", type=EXISTING, help="Left out when the frame holds radiance.")
@click.option("--out", type=EXISTING, required=True, help="MAP.exr")
def polar(frame: Path, lens: Path, response: Path | None, out: Path) -> None:
    """Make the polar map of one fisheye frame."""
    from vemlight.capture.source import polar_file

    polar_file(frame, lens, response, out)


@main.group()
def luminaire() -> None:
    """Lamps close to the scene, as light fields between two planes."""


@luminaire.command()
@click.argument("recipe", type=EXISTING)
@click.option("--out", type=EXISTING, required=True, help="LAMP.exr")
def measure(recipe: Path, out: Path) -> None:
    """Measure a lamp that RECIPE describes on the virtual bench."""
    from vemlight.renderer.luminaire.authoring import measure as take

    take(recipe, out)


@luminaire.command("from-rays")
@click.argument("rays", type=EXISTING)
@click.option("--basis", type=click.Choice(["bell", "b-spline"]), default="bell", show_default=True)
@click.option("--functions", type=click.IntRange(2, 32), default=9, show_default=True, help="Basis functions on a side.")
@click.option("--pixels", type=click.IntRange(1, 1024), default=48, show_default=True, help="On a side of each image.")
@click.option("--angle", type=click.FloatRange(1, 87), default=76.0, show_default=True, help="Degrees off the axis that the planes catch.")
@click.option("--spacing", type=click.FloatRange(0, min_open=True), help="Metres between basis functions; left out: as the rays need.")
@click.option("--distance", type=click.FloatRange(0, min_open=True), help="Metres between the planes; left out: as the rays need.")
@click.option("--plane-z", type=float, help="Height of the sampling plane in the file's metres; left out: where they are least spread.")
@click.option("--out", type=EXISTING, required=True, help="LAMP.exr")
def from_rays(rays: Path, out: Path, **options: Any) -> None:
    """Make a lamp of a measured ray file (IES TM-25)."""
    from vemlight.renderer.luminaire.authoring import from_rays as make

    made = make(
        rays,
        out,
        basis=options["basis"],
        functions=options["functions"],
        pixels=options["pixels"],
        angle_deg=options["angle"],
        spacing_m=options["spacing"],
        distance_m=options["distance"],
        plane_z_m=options["plane_z"],
    )
    for name, flux in made.ledger._asdict().items():
        click.echo(f"{name.replace('_', ' ')}: {flux:.2f}")
    click.echo(f"flux in the file's header: {made.header_flux}; the lamp's origin in the file: {made.origin_m} m")


@luminaire.command()
@click.argument("lamp", type=EXISTING)
@click.option("--out", type=EXISTING, help="Folder for pictures: its images, flux by angle, a plane lit at three distances.")
def show(lamp: Path, out: Path | None) -> None:
    """Say what a lamp file holds (.exr, .ies, .ldt)."""
    from vemlight.renderer.luminaire.authoring import report, write_pictures

    click.echo("\n".join(report(lamp)))
    if out:
        write_pictures(lamp, out)


@main.command()
@click.argument("maps", nargs=-1, required=True, type=EXISTING, metavar="MAP...")
@click.option("--out", type=EXISTING, required=True, help="Folder for the charts and their numbers.")
def chart(maps: tuple[Path, ...], out: Path) -> None:
    """Chart how true, steady and quick each method is on your own maps."""
    from vemlight.commands.chart import chart as draw

    draw(list(maps), out)


@main.command()
@click.argument("settings", type=EXISTING, required=False)
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
def doctor(settings: Path | None, as_json: bool) -> None:
    """Say what works on this machine; status 1 when something fails."""
    import msgspec

    from vemlight.commands.doctor import examine
    from vemlight.settings import read_settings

    failed = False
    for finding in examine(read_settings(settings)):
        failed |= finding.grade == "fail"
        if as_json:
            click.echo(msgspec.json.encode(finding).decode())
            continue
        colour = {"pass": "green", "warn": "yellow", "fail": "red"}[finding.grade]
        click.echo(f"{click.style(finding.grade, fg=colour)}  {finding.what}: {finding.found}")
        if finding.mend:
            click.echo(f"      -> {finding.mend}")
    sys.exit(1 if failed else 0)


@main.command()
@click.argument("folder", type=EXISTING)
def keys(folder: Path) -> None:
    """Make the keys that the services of one installation share between hosts."""
    from vemlight.runtime.transport import make_keys

    make_keys(folder)
    click.echo(f"keys are in {folder}: copy the folder to each host, keep it secret, and set [wire] keys to it")


@main.command()
@click.argument("service", type=click.Choice(SERVICES))
@click.argument("settings", type=EXISTING, required=False)
def health(service: Any, settings: Path | None) -> None:
    """Ask a running service whether it lives: status 0 when it says so, 1 when not."""
    from vemlight.runtime.health import check_health
    from vemlight.settings import read_settings

    check_health(read_settings(settings), service)

