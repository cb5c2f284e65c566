"""Reads a dropped scene in a process of its own, with limits: `python -m vemlight.renderer.scene.upload_check FOLDER` writes the scene file
that shows it, and says what it is, or why not.
"""

import sys
from pathlib import Path

import numpy as np

from vemlight.errors import UserError
from vemlight.renderer.scene.mesh_files import read_meshes
from vemlight.renderer.scene.meshes import bounds
from vemlight.renderer.scene.scene import load_scene
from vemlight.runtime.child_limits import checked

SCENE_FILE = "scene.toml"
VIEW = np.array([0.75, -1.0, 0.45]) / np.linalg.norm([0.75, -1.0, 0.45])  # from the middle to the camera: three quarters, from above
DISTANCE = 3.2  # half diagonals of the box around it: at 40 degrees a sphere of that radius fills 0.9 of the height
GROUND = 8.0  # half diagonals from the middle to the ground's edge


def check(folder: Path) -> str:
    """Writes the scene file and returns what the scene is, in words. Raises UserError for what cannot be drawn."""
    path = next(file for file in folder.iterdir() if file.suffix == ".glb")
    parts = read_meshes(path, path.name).parts
    if not parts:
        raise UserError(f"{path.name}: has no meshes")
    low, high = bounds([part.geometry for part in parts])
    low, high = np.array([low[0], -high[2], low[1]]), np.array([high[0], -low[2], high[1]])  # glTF is y-up
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    eye = middle + DISTANCE * radius * VIEW
    (folder / SCENE_FILE).write_text(
        f"[camera]\nfrom = {_row(eye)}\nat = {_row(middle)}\n\n"
        f'[[mesh]]\nname = "ground"\nshape = "plane"\nscale = {GROUND * radius:.6g}\nat = {_row([*middle[:2], low[2]])}\n\n'
        f'[[mesh]]\nfile = "{path.name}"\n'
    )
    load_scene(folder / SCENE_FILE)
    triangles = sum(len(part.geometry.triangles) for part in parts)
    size = " x ".join(f"{side:.3g}" for side in high - low)
    return f"{len(parts)} meshes of {triangles} triangles, {size} m"


def _row(values) -> str:
    return "[" + ", ".join(f"{value:.6f}" for value in values) + "]"


if __name__ == "__main__":
    sys.exit(checked(check, Path(sys.argv[1])))
