"""The rest of a map that compact sources leave, for a USD stage: sources as distant lights, all else as a dome."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from vemlight.capture.frames import Frame
from vemlight.exchange.usd_file import Dome
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.images import write_exr
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import cell_from_direction, latlong_directions, map_irradiance


class Residual:
    """Writes a texture a frame into a folder; `dome` names them."""

    def __init__(self, folder: Path, scale: float | None) -> None:
        """scale: the stage's, cd/m2 per unit."""
        self._folder, self._scale = folder, scale
        self._names: list[str] = []

    @property
    def dome(self) -> Dome:
        return Dome(self._names, self._scale or 1.0)

    def take(self, lights: LightSet, frame: Frame) -> LightSet:
        """Writes the rest of a frame; the lights that are left of it. Raises OSError when the disk refuses."""
        sources, rest = sources_and_rest(lights, EnvironmentMap(frame.radiance, frame.coverage, frame.bright_cells))
        name = f"frame_{len(self._names):04d}.exr"
        write_exr(self._folder / name, latlong_from_polar(rest))
        self._names.append(f"./{self._folder.name}/{name}")
        return sources


@contextmanager
def residual_folder(stage: Path) -> Iterator[Path]:
    """A folder for the textures beside a stage; one that is new goes when the export fails."""
    folder = stage.with_name(f"{stage.stem}_residual")
    is_new = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        yield folder
    except BaseException:
        if is_new:
            shutil.rmtree(folder, ignore_errors=True)
        raise


def sources_and_rest(lights: LightSet, environment: EnvironmentMap) -> tuple[LightSet, EnvironmentMap]:
    """The lights that are compact sources of the map, and the map without them; together they have the lights' irradiance in each channel.

    What counts as a source is what glossy lobes reflect as one: services/light/reflected_light.py.
    """
    from vemlight.light.reflected_light import reflected_light  # here, since few ask for it

    found = reflected_light(lights, environment)
    if found.radiance is None:  # no lights
        return lights, environment._replace(radiance=np.zeros_like(environment.radiance))
    kept = found.direct > 0
    irradiance = (lights.irradiance * found.direct[:, None].astype(np.float32))[kept]
    extents = None if lights.covariances is None else lights.covariances[kept]
    sources = LightSet.of(lights.ids[kept], lights.directions[kept], irradiance, extents)
    left = lights.irradiance.sum(axis=0, dtype=np.float64) - irradiance.sum(axis=0, dtype=np.float64)
    held = map_irradiance(found.radiance, environment.coverage)
    scale = np.divide(np.maximum(left, 0), held, out=np.zeros(3), where=held > 0)
    return sources, environment._replace(radiance=(found.radiance * scale).astype(np.float32))


def latlong_from_polar(environment: EnvironmentMap) -> np.ndarray:
    """A polar map as a lat-long image (height, cols, 3) float32 whose pixels are its cells, mirrored; dark where it says nothing."""
    rows, cols, _ = environment.radiance.shape
    height = 2 * rows if environment.coverage == "hemisphere" else rows
    row, column = cell_from_direction(latlong_directions(height, cols), rows, cols, environment.coverage)
    cells = environment.radiance[np.minimum(row.astype(int), rows - 1), column.astype(int) % cols]
    return np.where((row < rows)[..., None], cells, 0).astype(np.float32)
