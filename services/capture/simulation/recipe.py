"""Makes a bundled sequence again from its recipe: `python -m vemlight.capture.simulation.recipe replay_data/NAME`."""

import sys
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from vemlight.capture.lens import read_lens
from vemlight.capture.simulation.sensor import VirtualCamera
from vemlight.capture.simulation.simulate import Lighting, simulate
from vemlight.errors import UserError
from vemlight.files import read_toml


class SequenceRecipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """recipe.toml, beside the frames that it makes and lens.toml, which it reads."""

    scene: str
    frames: Annotated[int, Meta(ge=1, le=100_000)]
    fps: Annotated[float, Meta(gt=0)]
    exposure_s: Annotated[float, Meta(ge=0)] = 0.0
    rotate_deg_per_frame: float = 0.0
    seed: Annotated[int, Meta(ge=0)] = 0


def remake(folder: Path, out: Path, frames: int = 0) -> None:
    """Makes the sequence of `folder` in `out`; `frames` above 0 stops after so many.

    Raises UserError for a recipe that cannot be followed.
    """
    recipe = read_toml(folder / "recipe.toml", SequenceRecipe)
    lighting = Lighting(maps=(recipe.scene,), rotate_deg_per_frame=recipe.rotate_deg_per_frame)
    camera = VirtualCamera(lens=read_lens(folder / "lens.toml"), fps=recipe.fps, exposure_s=recipe.exposure_s)
    simulate(lighting, camera, out, frames=min(frames or recipe.frames, recipe.frames), seed=recipe.seed)


if __name__ == "__main__":
    try:
        for name in sys.argv[1:]:
            remake(Path(name), Path(name))
    except UserError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
