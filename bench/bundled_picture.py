"""README's picture: the bundled scene under the bundled sky, two seconds later, and in the bundled interior.

python -m bench.bundled_picture [--out docs/pictures/bundled.jpg]
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).parents[1]
SEQUENCES = ROOT / "replay_data"
FRAMES = (("outdoor/sky_0000.exr", "1280x720"), ("outdoor/sky_0047.exr", "640x360"), ("interior/interior_0012.exr", "640x360"))
QUALITY = 90


def rendered(frame: Path, size: str, folder: Path) -> np.ndarray:
    """The picture of a frame, as a user would make it."""
    out = folder / f"{frame.stem}.png"
    command = ["render", str(frame), "--lens", str(frame.with_name("lens.toml")), "--size", size, "--background", "map", "--out", str(out)]
    subprocess.run([sys.executable, "-m", "vemlight", *command], check=True)
    return np.asarray(Image.open(out).convert("RGB"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "pictures" / "bundled.jpg")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        large, *small = (rendered(SEQUENCES / name, size, Path(folder)) for name, size in FRAMES)
    Image.fromarray(np.concatenate([large, np.concatenate(small, axis=1)])).save(chosen.out, quality=QUALITY)


if __name__ == "__main__":
    main()
