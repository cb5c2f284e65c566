"""The commands that make and describe lamp files."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from vemlight.commands.parameters import PATH, Number, OutFile, OutFolder

if TYPE_CHECKING:
    from vemlight.renderer.luminaire.bases import BasisKind


@click.group()
def luminaire() -> None:
    """Lamps close to the scene, as light fields between two planes."""


@luminaire.command()
@click.argument("recipe", type=PATH)
@click.option("--out", type=OutFile(".exr"), required=True, help="LAMP.exr")
def measure(recipe: Path, out: Path) -> None:
    """Measure the lamp that RECIPE describes with the virtual goniophotometer."""
    from vemlight.renderer.luminaire import authoring

    authoring.measure(recipe, out)


@luminaire.command("from-rays")
@click.argument("rays", type=PATH)
@click.option("--basis", type=click.Choice(["bell", "b-spline"]), default="bell", show_default=True)
@click.option("--functions", type=click.IntRange(2, 32), default=9, show_default=True, help="Basis functions on a side.")
@click.option("--pixels", type=click.IntRange(1, 1024), default=48, show_default=True, help="On a side of each image.")
@click.option("--angle", type=Number(1, 87), default=76.0, show_default=True, help="Degrees from the axis that the planes catch.")
@click.option("--spacing", type=Number(0, min_open=True), help="Metres between basis functions; left out: wide enough for the rays.")
@click.option("--distance", type=Number(0, min_open=True), help="Metres between the planes; left out: ten spacings.")
@click.option("--plane-z", type=Number(-1000, 1000), help="Of the sampling plane, in metres; left out: where the beam is narrowest.")
@click.option("--out", type=OutFile(".exr"), required=True, help="LAMP.exr")
def from_rays(
    rays: Path, basis: "BasisKind", functions: int, pixels: int, angle: float, spacing: float | None, distance: float | None,
    plane_z: float | None, out: Path,
) -> None:  # fmt: skip
    """Make a lamp from a measured ray file (IES TM-25)."""
    from vemlight.renderer.luminaire import authoring

    options = authoring.RayOptions(
        basis=basis, functions=functions, pixels=pixels, angle_deg=angle, spacing_m=spacing, distance_m=distance, plane_z_m=plane_z
    )
    made = authoring.from_rays(rays, out, options)
    unit = "lm" if made.field.unit == "photometric" else "W"
    for name, flux in made.flux_budget._asdict().items():
        click.echo(f"{name.replace('_', ' ')}: {flux:.5g} {unit}")
    click.echo(f"made up for what was lost: multiplied by {made.factor:.5g}, {made.flux_budget.captured * made.factor:.5g} {unit} in all")
    origin = ", ".join(f"{along:.5g}" for along in made.origin_m)
    click.echo(f"flux in the file's header: {made.header_flux:.5g} {unit}; the lamp's origin in the file: {origin} m")


@luminaire.command()
@click.argument("lamp", type=PATH)
@click.option("--lamp-set", type=click.IntRange(1), help="Of a .ldt with alternative lamps: which, from 1; left out: the first.")
@click.option("--out", type=OutFolder(), help="Folder for pictures: its images, flux by angle, a plane lit at three distances.")
def show(lamp: Path, lamp_set: int | None, out: Path | None) -> None:
    """Describe a lamp file (.exr, .ies, .ldt)."""
    from vemlight.renderer.luminaire import inspection

    click.echo("\n".join(inspection.describe(lamp, lamp_set or 0)))
    if out:
        inspection.write_pictures(lamp, out, lamp_set or 0)


COMMANDS = (luminaire,)
