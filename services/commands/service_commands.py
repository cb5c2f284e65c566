"""The commands that run services, look after them, or look at the machine that they run on."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vemlight.commands.fixture_commands import rig_path
from vemlight.commands.parameters import MODE, PATH, InstanceName, OutFolder
from vemlight.commands.source_options import capture_settings, source_options

if TYPE_CHECKING:
    from vemlight.choices import Mode
    from vemlight.runtime.channels import Instance, Service

# Of the bundled scene, composed for 16:9; as large as the page shows it on a small screen, and as two cores draw ten times a second.
BUNDLED_RENDERER = {"width": 480, "height": 270, "background": "map"}
COLOURS = {"pass": "green", "warn": "yellow", "fail": "red"}


@click.command()
@click.argument("settings", type=PATH, required=False)
@click.option("--source", help="Instead of the settings' source: a lat-long map, a folder, a recording, a film, a stream, or /dev/videoN.")
@click.option("--frames", type=click.IntRange(1), help="Stop after so many frames.")
@click.option("--out", type=OutFolder(), help="Folder for the lights (.jsonl), the pictures (EXR and PNG) and a contact sheet.")
@click.option("--mode", type=MODE, help="live: the newest frame wins; lossless (with --out): every frame.")
@click.option("--overwrite", is_flag=True, help="Remove what another run has left in that folder.")
@click.option("--rig", type=PATH, help="Real fixtures to drive, as [fixtures] rig; `bundled`: one to try. A preview until it is armed.")
@source_options
def run(
    settings: Path | None, source: str | None, frames: int | None, out: Path | None, mode: "Mode | None", overwrite: bool, rig: Path | None,
    **reading: object,
) -> None:
    """Start capture, sampler, renderer and viewer, and supervise them. With --out, a run that was cut off goes on where it ended."""
    import msgspec

    from vemlight.commands.run_checks import check_run
    from vemlight.errors import UserError
    from vemlight.runtime.supervise import supervise
    from vemlight.settings_file import read_settings

    wanted = read_settings(settings)
    if settings is None and source is None:  # the bundled sequence and scene, as they look best
        wanted = msgspec.structs.replace(wanted, renderer=msgspec.structs.replace(wanted.renderer, **BUNDLED_RENDERER))
    capture = capture_settings(wanted.capture, source, {"frames": frames, **reading})
    if "capture" in wanted.wire.elsewhere and capture != wanted.capture:
        text = "capture runs elsewhere, and the options given are for a source; give them to that run"
        raise UserError(f"{settings}: [wire] elsewhere: {text}")
    wanted = msgspec.structs.replace(wanted, capture=capture)
    if out:
        wanted = msgspec.structs.replace(wanted, out=str(out.resolve()), mode="lossless")
    if rig:
        fixtures = msgspec.structs.replace(wanted.fixtures, rig=str(rig_path(rig).resolve()))
        wanted = msgspec.structs.replace(wanted, fixtures=fixtures)
    if mode:
        wanted = msgspec.structs.replace(wanted, mode=mode)
    check_run(wanted, settings, source_option=bool(source))
    sys.exit(supervise(wanted, overwrite))


def _service(name: "Service", summary: str) -> click.Command:
    @click.command(name, help=f"One service: {summary}")
    @click.argument("settings", type=PATH, required=False)
    def command(settings: Path | None, camera: str | None = None) -> None:
        from importlib import import_module

        from vemlight.runtime.start import start

        given = [str(each) for each in (settings, camera) if each]
        sys.exit(start(import_module(f"vemlight.{name}.__main__").main, given))

    return click.argument("camera", required=False)(command) if name == "capture" else command


@click.command()
@click.argument("settings", type=PATH, required=False)
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line.")
@click.option("--write", type=PATH, help="Run the settings for some minutes, and write a file of those that hold their rate here.")
def doctor(settings: Path | None, as_json: bool, write: Path | None) -> None:
    """Check what works on this machine; status 1 when something fails."""
    import msgspec

    from vemlight.commands.doctor import examine
    from vemlight.commands.machine_settings import check_new, fitting, run_windows, write_fit
    from vemlight.settings_file import read_settings

    wanted, findings = read_settings(settings), []
    if write:
        check_new(write, wanted)
    for finding in examine(wanted):
        findings.append(finding)
        if as_json:
            click.echo(msgspec.json.encode(finding).decode())
            continue
        click.echo(f"{click.style(finding.grade, fg=COLOURS[finding.grade])}  {finding.what}: {finding.found}")
        if finding.hint:
            click.echo(f"      -> {finding.hint}")
    failed = any(finding.grade == "fail" for finding in findings)
    if write and not failed:
        if settings is None:
            wanted = msgspec.structs.replace(wanted, renderer=msgspec.structs.replace(wanted.renderer, **BUNDLED_RENDERER))
        on_gpu = any(finding.what == "OpenGL" and finding.grade == "pass" for finding in findings)
        fit = fitting(wanted, on_gpu, run_windows, lambda line: click.echo(f"      {line}", err=True))
        write_fit(write, fit, findings)
        click.echo(f"wrote {write}: vemlight run {write}", err=as_json)
    sys.exit(1 if failed else 0)


@click.command("settings")
def settings_() -> None:
    """Print all settings as a Markdown page: type, default, unit, range and meaning of each key."""
    from vemlight.commands.settings_reference import settings_reference

    click.echo(settings_reference(), nl=False)


@click.command()
@click.argument("folder", type=OutFolder())
def keys(folder: Path) -> None:
    """Make the keys that the services of one installation share between hosts."""
    from vemlight.runtime.transport import make_keys

    make_keys(folder)
    click.echo(f"keys are in {folder}: copy the folder to each host, keep it secret, and set [wire] keys to it")


@click.command()
@click.argument("service", type=InstanceName())
@click.argument("settings", type=PATH, required=False)
def health(service: "Instance", settings: Path | None) -> None:
    """Ask a running service (of several, by its name: capture.left) for its status: exit status 0 when it answers, 1 when not."""
    from vemlight.runtime.health import check_health
    from vemlight.settings_file import read_settings

    check_health(read_settings(settings), service)


@click.command("verify")
@click.argument("folder", type=PATH)
def verify_(folder: Path) -> None:
    """Check that a recording or the output of a run is what was written: SHA-256 of the files, chain of the manifest."""
    from vemlight.commands.verify import verify

    findings, summary = verify(folder)
    for line in findings:
        click.echo(f"vemlight: {line}", err=True)
    if findings:
        sys.exit(2)
    click.echo(f"{folder}: whole: {summary}")


COMMANDS = (
    run,
    _service("capture", "frames of a recording or a camera become polar maps."),
    _service("fuse", "the polar maps of a rig of cameras become one, and near lights."),
    _service("sampler", "polar maps become lights."),
    _service("renderer", "lights become pictures of the scene."),
    _service("viewer", "the page that shows it all."),
    _service("plate", "a second camera's picture behind the scene."),
    _service("fixtures", "lights become levels of real fixtures."),
    doctor,
    settings_,
    keys,
    health,
    verify_,
)
