"""USD scenes (.usd, .usda, .usdc, .usdz) as glTF: usd-core reads them in a process of its own, and hands over the bytes of a .glb.

A damaged file may end usd-core by a signal, or make it compute or take memory without end: that ends the other process, and the file is
refused. What it makes passes through the reader of glTF with all its limits.
"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import vemlight
from vemlight.errors import UserError

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MAX_S = 600.0  # of a file of a gigabyte; a million triangles take ten
REFUSED = 2  # exit status of a file that is refused


class UsdScene(NamedTuple):
    """A scene as the bytes of a .glb. stored_bytes: of all files that it was made of. left_out: a line for each thing that is not drawn."""

    glb: bytes
    stored_bytes: int
    left_out: list[str]


def read_usd(path: Path) -> UsdScene:
    """The scene of a file. Raises UserError for one that cannot be read, refers to files outside its folder, or without usd-core."""
    if importlib.util.find_spec("pxr") is None:
        raise UserError(f"{path}: is read by usd-core, which is not installed; pip install 'vemlight[usd]', or export the scene as glTF")
    # What stands in the working folder or is named by the environment must not be loaded as a module or a plug-in.
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PXR_", "USD_"))}
    package = str(Path(vemlight.__file__).parents[1])
    environment |= {"PYTHONPATH": os.pathsep.join([package, *filter(None, [environment.get("PYTHONPATH")])]), "PXR_WORK_THREAD_LIMIT": "1"}
    command = [sys.executable, "-P", "-m", "vemlight.renderer.scene.usd_convert", os.path.abspath(path)]
    with tempfile.TemporaryFile() as out:
        try:
            done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.DEVNULL, env=environment, timeout=MAX_S)
        except subprocess.TimeoutExpired as error:
            raise UserError(f"{path}: takes over {MAX_S:.0f} s to read; export it as glTF") from error
        out.seek(0)
        head, content = out.readline(2**20), out.read()
    if done.returncode == 0:
        return UsdScene(content, **json.loads(head))
    if done.returncode == REFUSED and head:
        raise UserError(f"{path}: {json.loads(head)['refused']}")
    raise UserError(f"{path}: usd-core could not read it (exit status {done.returncode}); export it again")
