"""The commands around a camera: simulate one, calibrate its lens and sensor, record it, unwrap one of its frames."""

import sys
import tempfile
from pathlib import Path

import click

from vemlight.commands.options import LensOptions, ResponseOptions, SimulateOptions, options_as
from vemlight.commands.parameters import PATH, STANDARD_OUTPUT, Number, OutFile, OutFolder, eight_numbers, width_height
from vemlight.commands.report import Report, reporting
from vemlight.commands.source_options import Assignment, Numbers, capture_settings, source_options
from vemlight.errors import UserError, of_setting
from vemlight.files import writing_to


@click.command()
@click.argument("maps", nargs=-1, required=True, metavar="MAP...")
@click.option("--lens", type=PATH, required=True, help="Lens file of the camera to simulate.")
@click.option("--response", type=PATH, help="Response file; left out: radiance instead of raw codes.")
@click.option("--out", type=OutFolder(), required=True, help="Folder for the frames and the ground truth.")
@click.option("--frames", type=click.IntRange(1), help="How many; left out: one for each map.")
@click.option("--fps", type=Number(0, 1000, min_open=True), default=25.0, show_default=True)
@click.option("--rotate", "rotate_deg", type=Number(-360, 360), default=0.0, show_default=True, help="Degrees a frame, about the vertical.")
@click.option("--keyframes", type=PATH, help="Motion instead: TOML of [[key]] time_s, rotate_deg = [x, y, z].")
@click.option("--noise", "noise_codes", type=Number(0), default=0.0, show_default=True, help="Noise in code steps (sigma).")
@click.option("--pattern", "pattern_codes", type=Number(0), default=0.0, show_default=True, help="Fixed pattern noise (sigma).")
@click.option("--mosaic", type=click.Choice(["mono", "RGGB", "GRBG", "GBRG", "BGGR"]), help="One value a pixel; left out: three.")
@click.option("--exposure", "exposure_s", type=Number(0), default=0.0, show_default=True, help="Seconds, for mains flicker.")
@click.option("--flicker", "flicker_hz", type=Number(0), default=0.0, show_default=True, help="Hz: 100 or 120 for mains.")
@click.option("--exposures", type=Numbers(0), metavar="S,S,..", default="", help="Taken in turn, in seconds; a player recognises them.")
@click.option("--control-delay", type=click.IntRange(1, 4), default=2, show_default=True, help="Frames until an exposure takes effect.")
@click.option("--sway", type=Numbers(2), metavar="DEGREES,HZ", default="0,0", show_default=True, help="Of the camera.")
@click.option("--dropouts", type=Number(0, 1), default=0.0, show_default=True, help="Fraction of frames that are lost.")
@click.option("--truth", is_flag=True, help="Write the true radiance of each frame, too.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@options_as(SimulateOptions)
def simulate(options: SimulateOptions) -> None:
    """The virtual camera: lat-long maps (or a built-in scene: sky, interior) in, raw fisheye frames out."""
    from vemlight.capture.lens import read_lens
    from vemlight.capture.response import read_response
    from vemlight.capture.simulation.sensor import VirtualCamera
    from vemlight.capture.simulation.simulate import Lighting
    from vemlight.capture.simulation.simulate import simulate as simulate_frames

    lighting = Lighting(
        maps=options.maps, rotate_deg_per_frame=options.rotate_deg, keyframes=options.keyframes, flicker_hz=options.flicker_hz,
        sway_deg=options.sway[0], sway_hz=options.sway[1],
    )  # fmt: skip
    camera = VirtualCamera(
        lens=read_lens(options.lens),
        response=read_response(options.response) if options.response else None,
        mosaic=options.mosaic,
        fps=options.fps,
        exposure_s=options.exposure_s,
        exposures=options.exposures,
        control_delay=options.control_delay,
        noise_codes=options.noise_codes,
        pattern_codes=options.pattern_codes,
        dropouts=options.dropouts,
    )
    with writing_to(options.out):
        simulate_frames(lighting, camera, options.out, frames=options.frames or 0, truth_maps=options.truth, seed=options.seed)
    click.echo(f"{options.out}: the frames, their lens.toml, and the truth in truth.jsonl")


@click.group()
def calibrate() -> None:
    """Calibrate a camera, its lens and its sensor's response, or a rig of fixtures."""


@calibrate.command()
@click.argument("images", nargs=-1, required=True, type=PATH, metavar="IMAGE...")
@click.option("--board", metavar="COLUMNSxROWS", required=True, callback=width_height, help="Inner corners, such as 8x6.")
@click.option("--square", "square_m", type=Number(0, 10, min_open=True), required=True, help="Side of a square in metres.")
@click.option("--dictionary", default="", help="ChArUco board: OpenCV's name of its markers, such as DICT_4X4_50.")
@click.option("--marker", "marker_m", type=Number(0, 10), default=0.0, help="ChArUco board: side of a marker in metres.")
@click.option("--rim", "rim_deg", type=Number(0, 180), default=0.0, help="Degrees off the axis where the image circle ends; 0: detected.")
@click.option("--accept", is_flag=True, help="Accept a lens that fits its corners badly.")
@click.option("--picture", type=OutFile(".png"), help="PNG of coverage and residuals; left out: beside the lens file.")
@click.option("--out", type=OutFile(".toml"), required=True, help="LENS.toml")
@options_as(LensOptions)
def lens(options: LensOptions) -> None:
    """Calibrate the lens from photographs of a chessboard."""
    from vemlight.capture.calibration.boards import CalibrationBoard
    from vemlight.capture.calibration.lens_calibration import calibrate_lens, lens_summary

    board = CalibrationBoard(options.board, options.square_m, options.dictionary, options.marker_m)
    picture = options.picture or options.out.with_suffix(".png")
    report = calibrate_lens(list(options.images), board, options.out, rim_deg=options.rim_deg, accept=options.accept, picture=picture)
    click.echo(f"{lens_summary(report)}\nsee {picture}")


@calibrate.command()
@click.argument("patches", type=PATH)
@click.option("--brackets", is_flag=True, help="PATCHES is a folder of photographs of one view; their exposures say the response.")
@click.option("--kind", type=click.Choice(["log", "companding", "linear", "srgb"]), help="Of the sensor; left out: log.")
@click.option("--bits", type=click.IntRange(1, 16), help="Bits of a code; left out: the fewest of 8, 10, 12, 14, 16 that hold all codes.")
@click.option("--accept", is_flag=True, help="Accept an error above 5 % at a check patch.")
@click.option("--white", "white_cd_m2", type=Number(0, min_open=True), help="PATCHES is a ColorChecker: its white in cd/m2.")
@click.option(
    "--corners",
    metavar="X,Y,X,Y,X,Y,X,Y",
    callback=eight_numbers,
    help="Pixels of its dark skin, bluish green, black and white patch; left out: detected.",
)
@click.option("--picture", type=OutFile(".png"), help="PNG of the fit; left out: beside the response file.")
@click.option("--out", type=OutFile(".toml"), required=True, help="RESPONSE.toml")
@options_as(ResponseOptions)
def response(options: ResponseOptions) -> None:
    """Calibrate the sensor's response from patches of known luminance (CSV: code, luminance, use = fit or check)."""
    if options.brackets:
        from vemlight.capture.calibration.bracket_response import bracket_summary, calibrate_from_brackets

        others = {"--kind": options.kind, "--white": options.white_cd_m2, "--corners": options.corners, "--picture": options.picture}
        if unfit := next((name for name, value in others.items() if value is not None), None):
            raise UserError(f"{unfit}: is for patches, and --brackets for photographs; leave one of them out")
        found = calibrate_from_brackets(options.patches, options.out, bits=options.bits or 0, accept=options.accept)
        click.echo(bracket_summary(found))
        return
    from vemlight.capture.calibration.colorchecker import chart_from_corners, find_chart
    from vemlight.capture.calibration.patches import read_patches
    from vemlight.capture.calibration.response_fit import calibrate_response, gray_patches, response_summary
    from vemlight.light.images import read_codes

    if options.corners and not options.white_cd_m2:
        raise UserError("--corners: needs --white as well; add the luminance of the white patch")
    if options.white_cd_m2:
        codes = read_codes(options.patches)
        chart = chart_from_corners(options.corners) if options.corners else find_chart(codes)
        patches = gray_patches(codes, chart, options.white_cd_m2)
    else:
        patches = read_patches(options.patches)
    picture = options.picture or options.out.with_suffix(".png")
    with of_setting(str(options.patches)):
        report = calibrate_response(
            patches, options.out, kind=options.kind or "log", bits=options.bits or 0, accept=options.accept, picture=picture
        )
    click.echo(f"{response_summary(report)}\nsee {picture}")


@calibrate.command()
@click.argument("camera")
@click.option("--format", "form", default="", help="Pixel format by the kernel's letters, such as YUYV or MJPG.")
@click.option("--size", metavar="WIDTHxHEIGHT", default="0x0", callback=width_height, help="Left out: the camera's own.")
@click.option("--fps", type=Number(0, 1000, min_open=True), default=30.0, show_default=True)
@click.option("--control", "controls", type=Assignment(), multiple=True, help="NAME=VALUE of a control, such as gain=0.")
@click.option("--accept", is_flag=True, help="Accept a response whose exposures contradict each other.")
@click.option("--out", type=OutFile(".toml"), required=True, help="RESPONSE.toml")
def webcam(
    camera: str, form: str, size: tuple[int, int], fps: float, controls: tuple[tuple[str, int], ...], accept: bool, out: Path
) -> None:
    """Calibrate the response of a camera in colour, such as /dev/video0, by exposures that it takes of a scene at rest."""
    from vemlight.capture.calibration.bracket_response import bracket_summary
    from vemlight.capture.calibration.webcam_response import calibrate_webcam
    from vemlight.commands.run_checks import check_camera
    from vemlight.settings import Capture
    from vemlight.settings_file import section_from_options

    check_camera(camera)
    given = {"source": camera, "format": form, "width": size[0], "height": size[1], "fps": fps, "controls": dict(controls)}
    found, exposures = calibrate_webcam(section_from_options(Capture, given), out, accept=accept)
    click.echo(f"{bracket_summary(found)}\nexposures = [{', '.join(f'{exposure:g}' for exposure in exposures)}] span what it can")


@click.command()
@click.argument("settings", type=PATH, required=False)
@click.option("--source", help="Instead of the settings' source: a file, a folder, a stream, or /dev/videoN.")
@click.option("--frames", type=click.IntRange(1), help="Number of frames; left out: all, or until Ctrl-C.")
@click.option("--out", type=OutFolder(), required=True, help="Folder for the recording.")
@source_options
@reporting
def record(settings: Path | None, source: str | None, frames: int | None, out: Path, **reading: object) -> Report:
    """Record a camera's raw frames, or a file or stream as polar maps, with all metadata in the headers."""
    from vemlight.capture import recording
    from vemlight.settings_file import read_settings

    wanted = capture_settings(read_settings(settings).capture, source, {"record": str(out), **reading})
    done = recording.record(wanted, frames or 0)
    if done.last_error:
        raise UserError(f"{done.last_error}: {done.written} are written and {done.failed} lost; make room, or record elsewhere")
    values = {"out": str(out), "written": done.written, "dropped": done.dropped, "failed": done.failed}
    return Report(f"{done.written} frames are in {out}; {done.dropped} dropped, {done.failed} refused by the disk", values)


@click.command()
@click.argument("frame", type=PATH)
@click.option("--out", type=OutFile(".exr", dash=True), required=True, help="MAP.exr, or - for standard output.")
@source_options
@reporting
def polar(frame: Path, out: Path, **reading: object) -> Report:
    """Make the polar map of one fisheye frame, of another image, or of a film's first picture."""
    from vemlight.capture.recording import polar_file
    from vemlight.settings import Capture

    wanted = capture_settings(Capture(), str(frame), reading)
    if out != STANDARD_OUTPUT:
        made = polar_file(wanted, out)
    elif sys.stdout.isatty():
        raise UserError("--out -: a map is no text for a terminal; send it to a file or a program, or name a file")
    else:
        with tempfile.TemporaryDirectory() as folder:  # OpenEXR writes files only
            made = polar_file(wanted, Path(folder) / "map.exr")
            sys.stdout.buffer.write((Path(folder) / "map.exr").read_bytes())
    rows, cols = made.radiance.shape[:2]
    clipped = f"{made.black} values at the sensor's lowest code, {made.saturated} at its highest"
    values = {"out": str(out), "coverage": made.coverage, "rows": rows, "cols": cols, "black": made.black, "saturated": made.saturated}
    return Report(f"{out}: a {made.coverage} of {rows} x {cols} cells; {clipped}", values)


COMMANDS = (simulate, calibrate, record, polar)
