"""The commands around real fixtures."""

import sys
from itertools import chain
from pathlib import Path
from typing import Any

import click

from vemlight.commands.capture_commands import calibrate
from vemlight.commands.parameters import PATH, STANDARD_OUTPUT, Number, OutFile, width_height
from vemlight.errors import UserError

OF_BOARD = {"board": "--board", "square_m": "--square", "views": "--views"}
OF_CAMERAS = {"wand": "--wand", "coverage": "--coverage", **OF_BOARD, "dictionary": "--dictionary", "marker_m": "--marker"}
OF_FIXTURES = {"settings": "SETTINGS", "arm": "--arm", "settle_s": "--settle", "level": "--level"}
BUNDLED = "bundled"  # the word that names the rig of this package


def rig_path(name: Path) -> Path:
    """The rig file of that name, of the package for BUNDLED."""
    return Path(__file__).parents[1] / "fixtures" / "rigs" / "dome.toml" if str(name) == BUNDLED else name


@click.command()
@click.argument("rig", type=PATH)
@click.argument("settings", type=PATH, required=False)
@click.option("--lights", type=PATH, help="LIGHTS.jsonl to play at its own times; left out: those of a sampler that runs with SETTINGS.")
@click.option("--out", type=OutFile(".jsonl", dash=True), help="LEVELS.jsonl, or -: write the levels of --lights, and send nothing.")
@click.option("--arm", is_flag=True, help="Send live; left out: a preview, which no fixture shows.")
@click.option("--blackout", is_flag=True, help="Send darkness before the end.")
def dmx(rig: Path, settings: Path | None, lights: Path | None, out: Path | None, arm: bool, blackout: bool) -> None:
    """Drive real fixtures: levels that make the light at a person the map's, by sACN, Art-Net or DDP. RIG `bundled` is one to try."""
    path = rig_path(rig)
    if out and not lights:
        raise UserError("--out: writes the levels of a file of lights; add --lights LIGHTS.jsonl")
    if out and (arm or blackout):
        raise UserError("--out: sends nothing; leave out --arm and --blackout")
    if lights and settings:
        raise UserError(f"--lights: takes the place of a sampler; leave out {settings}")
    if lights:
        _of_lights(path, lights, out, arm, blackout)
    else:
        _of_sampler(path, settings, arm, blackout)


def _of_lights(path: Path, lights: Path, out: Path | None, arm: bool, blackout: bool) -> None:
    from vemlight.files import written_whole
    from vemlight.fixtures.check import check_rig_file
    from vemlight.fixtures.playback import levels_lines, play

    rig = check_rig_file(path)
    if out is None:
        play(rig, str(path), lights, arm=arm, blackout=blackout)
    elif out == STANDARD_OUTPUT:
        for line in levels_lines(rig, lights):
            sys.stdout.buffer.write(line)
    else:
        lines, count = levels_lines(rig, lights), 0
        first = next(lines)  # what cannot be read is found before anything is written
        with written_whole(out) as part, open(part, "wb") as file:
            for line in chain([first], lines):
                file.write(line)
                count += 1
        click.echo(f"{out}: the levels of {count} frames")


def _of_sampler(path: Path, settings: Path | None, arm: bool, blackout: bool) -> None:
    import msgspec

    from vemlight.fixtures.check import check_rig_file
    from vemlight.fixtures.service import main
    from vemlight.settings import Fixtures
    from vemlight.settings_file import read_settings

    wanted = read_settings(settings)
    check_rig_file(path)
    main(msgspec.structs.replace(wanted, fixtures=Fixtures(rig=str(path.resolve()), arm=arm, blackout=blackout)))


@calibrate.command("rig")
@click.argument("rig", type=PATH)
@click.argument("settings", type=PATH, required=False)
@click.option("--wand", metavar="A,B:METRES", help="Cameras: the measured distance of two of them, such as left,right:1.25.")
@click.option("--coverage", type=click.Choice(["hemisphere", "sphere"]), default="hemisphere", help="Cameras: of the maps.")
@click.option("--board", metavar="COLUMNSxROWS", callback=width_height, help="Cameras: inner corners of a board in photographs of theirs.")
@click.option("--square", "square_m", type=Number(0, 10, min_open=True), help="Cameras: side of the board's squares in metres.")
@click.option("--views", type=PATH, help="Cameras: folder with a folder of photographs for each camera, the n-th of all of one moment.")
@click.option("--dictionary", default="", help="Cameras, ChArUco board: OpenCV's name of its markers, such as DICT_4X4_50.")
@click.option("--marker", "marker_m", type=Number(0, 10), default=0.0, help="Cameras, ChArUco board: side of a marker in metres.")
@click.option("--arm", is_flag=True, help="Fixtures: needed, as each emitter goes to full, one at a time.")
@click.option("--settle", "settle_s", type=Number(0, 60), default=0.5, show_default=True, help="Fixtures: from a level to its picture, s.")
@click.option("--level", type=Number(0.01, 1), default=1.0, show_default=True, help="Fixtures: of each emitter, if full clips the camera.")
@click.pass_context
def calibrate_rig(
    context: click.Context, rig: Path, settings: Path | None, arm: bool, settle_s: float, level: float, **of_cameras: Any
) -> None:
    """Measure a rig, and write what was measured to RIG.

    Of cameras ([[camera]]): where they stand and look, from their recordings of a small lamp that is carried where all see it (--wand), or
    from photographs of a board that they took at the same moments (--board, --square, --views).
    Of fixtures ([[fixture]]): their colours and strengths, by the camera of SETTINGS at the target (--arm).
    """
    from vemlight.commands.camera_rig_calibration import is_camera_rig
    from vemlight.commands.rig_calibration import calibrate_rig_file

    given = {name for name in context.params if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE}
    has_cameras = is_camera_rig(rig)
    for name, shown in (OF_FIXTURES if has_cameras else OF_CAMERAS).items():
        if name in given:
            kinds = ("fixtures", "cameras") if has_cameras else ("cameras", "fixtures")
            raise UserError(f"{shown}: is for rigs of {kinds[0]}, and {rig} holds {kinds[1]}; leave it out")
    if has_cameras:
        if "coverage" in given and of_cameras["board"]:
            raise UserError("--coverage: is of the maps in which a lamp is looked for, and --board needs none; leave it out")
        click.echo(_calibrate_cameras(rig, **of_cameras))
        return
    if settings is None:
        raise UserError("SETTINGS: is missing; name the settings whose camera stands at the target")
    if not arm:
        raise UserError("--arm: each emitter goes to full, one at a time; add --arm when everybody is ready")
    calibrate_rig_file(rig, settings, settle_s=settle_s, level=level)


def _calibrate_cameras(
    rig: Path,
    wand: str | None,
    coverage: str,
    board: tuple[int, int] | None,
    square_m: float | None,
    views: Path | None,
    dictionary: str,
    marker_m: float,
) -> str:
    """By the wand or by a board. Returns lines about the poses."""
    from vemlight.capture.calibration.boards import CalibrationBoard
    from vemlight.commands.camera_rig_calibration import calibrate_camera_rig, calibrate_camera_rig_by_board, wand_from_text

    if wand is not None:
        if board or square_m or views or dictionary or marker_m:
            raise UserError("--wand: is one way, and a board another; leave out --wand, or --board and what belongs to it")
        return calibrate_camera_rig(rig, wand_from_text(wand), coverage)
    if board is None and square_m is None and views is None:
        raise UserError("--wand: is missing; add the measured distance of two cameras: --wand A,B:METRES, or --board, --square and --views")
    if board is None or square_m is None or views is None:
        missing = next(shown for shown, value in zip(OF_BOARD.values(), (board, square_m, views), strict=True) if value is None)
        raise UserError(f"{missing}: is missing; poses by a board take --board COLUMNSxROWS, --square METRES and --views FOLDER")
    return calibrate_camera_rig_by_board(rig, views, CalibrationBoard(board, square_m, dictionary, marker_m))


COMMANDS = (dmx,)
