"""The pictures of docs/luminaires.md.

    python -m bench.luminaire_pictures [--out docs/luminaires]

Uses the real LED and the photometry files in the folder VEMLIGHT_DATA when the variable names one.
"""

import argparse
import os
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bench.luminaires import DARK, DOWN, headlight, with_lamp, write
from tests.support.scenes import SHAPES
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import write_png
from vemlight.light.photometry import read_photometry
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.luminaire.authoring import from_rays
from vemlight.renderer.luminaire.inspection import contact_sheet, intensity_by_angle, lit_planes
from vemlight.renderer.luminaire.lightfield import LightField, far_intensity
from vemlight.renderer.luminaire.luminaire_file import read_luminaire
from vemlight.renderer.luminaire.reference import irradiance
from vemlight.renderer.output.tonemap import adapt, tone_mapped
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.luminaire_table import BUNDLED_LAMP
from vemlight.renderer.scene.scene import BUNDLED_SCENE, Scene, load_scene
from vemlight.settings import Renderer as Settings

LED = "luminaire/rayfile_LERTDUW_S2WP_green_100k_20161013_IES_TM25.TM25RAY"


def shown(scene: Scene, size: tuple[int, int], exposure: float = 0.0) -> np.ndarray:
    renderer = FrameSequence(Renderer(scene, Settings(width=size[0], height=size[1]), 4))
    try:
        picture = renderer.render(DARK)
        return tone_mapped(picture, adapt(None, picture, 0.0), exposure)[..., :3]
    finally:
        renderer.release()


def near_against_far(out: Path, field: LightField) -> None:
    """Irradiance on planes that face the lamp: the near field against its own far field taken as a point, over the distance."""
    size = 2 * 0.03  # the headlight's aperture
    rows = []
    for times in (1, 2, 5, 10, 20, 50, 100):
        off = []
        for angle in (0.0, 5.0, 10.0):
            d = np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
            r = times * size
            near = luminance_from_rgb(irradiance(field, r * d, DOWN))
            far = luminance_from_rgb(far_intensity(field, d)[0]) * d[2] / r**2
            off.append(float(far / near - 1))
        rows.append([times, times * size, *off])
    write(out / "luminaires_far.csv", ["distance in sizes", "m", "point / near - 1 on the axis", "5 degrees", "10 degrees"], rows)


def by_angle(out: Path, sources: dict) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4), dpi=110)
    for name, source in sources.items():
        theta, value = intensity_by_angle(source, 2.0)
        axes.plot(theta, value / value.max(), label=name)
    axes.set(xlabel="degrees from the axis", ylabel="intensity / its peak", xlim=(0, 120))
    axes.grid(alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(out / "intensity.png")
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/luminaires"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    torch, lamp = read_luminaire(BUNDLED_LAMP), headlight()
    write_png(out / "torch_images.png", cv2.resize(contact_sheet(torch), None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST))
    write_png(out / "torch_planes.png", lit_planes(torch, (0.1, 0.5, 2.0), 200))
    near_against_far(out, lamp)
    sources: dict = {"bundled torch (bench)": torch, "headlight (bench)": lamp}
    data = os.environ.get("VEMLIGHT_DATA")
    if data:
        with tempfile.TemporaryDirectory() as folder:
            led = from_rays(Path(data) / LED, Path(folder) / "led.exr").field
        write_png(out / "led_images.png", contact_sheet(led))
        sources |= {"LED (100,000 measured rays)": led, "TECTON (EULUMDAT)": read_photometry(Path(data) / "luminaire/ldt_sample4.ldt")}
    by_angle(out, sources)
    write_png(out / "headlights.png", shown(load_scene(BUNDLED_SCENE.with_name("headlights.toml")), (480, 300)))
    lit: dict[str, Any] = {"at": (-2.2, -1.6, 1.2), "rotate": (0.0, 108.0, 25.0), "samples": 128}
    kinds: list[dict[str, Any]] = [{"shadows": "traced"}, {"shadows": "maps"}, {"shadows": "maps", "method": "shift-invariant"}]
    panels = [shown(with_lamp(load_scene(SHAPES), lamp, **lit, **kind), (240, 180), 1.0) for kind in kinds]
    write_png(out / "shadows.png", np.hstack(panels))


if __name__ == "__main__":
    main()
