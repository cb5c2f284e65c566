"""Lights as a USD stage: z up, metres, a DistantLight for each id below `/vemlight`, its values as samples at the frames it lives in.

UsdLux: with `normalize` a DistantLight gives a plane that faces it `intensity x 2^exposure x color`, and shines along its -Z. Text (.usda)
and binary (.usdc) are both written here, a light at a time, so that memory does not grow with the recording.
"""

from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from vemlight.exchange.light_columns import LightColumns, LightRows
from vemlight.exchange.punctual import rotations_to
from vemlight.exchange.usd_attribute import Attribute, LayerHead, LayerWriter
from vemlight.exchange.usd_crate import CrateLayer
from vemlight.exchange.usd_text import TextLayer
from vemlight.files import written_whole

UsdDialect = Literal["standard", "blender"]


class Factors(NamedTuple):
    """What a program makes of a distant light's value: it is written divided by that."""

    intensity: float
    angle: float


DIALECTS: dict[UsdDialect, Factors] = {
    "standard": Factors(1, 1),
    "blender": Factors(4, 2),  # Blender 4.5's importer: strength 4 x intensity, angle doubled
}
DEFAULT_FPS = 24.0  # of one frame: USD's own
TIME_ERROR_S = 1e-3  # of the first and last time together: three decimals are the fewest that files have
ON_A_FRAME = 0.02  # of a frame: times that are so near to one are on it; with four decimals at 100 Hz they are
ROOT = "vemlight"
OF_EACH = (
    Attribute("bool", "inputs:normalize", True),
    Attribute("float", "inputs:exposure", 0.0),
    Attribute("bool", "inputs:enableColorTemperature", False),
)
ORDER = Attribute("token[]", "xformOpOrder", ["xformOp:orient"], is_uniform=True)
# A lat-long texture has +Y above, +Z in its centre and +X a quarter from the left (UsdLux, as OpenEXR's envmap); ours +Z, +X and +Y. So a
# third of a turn about (1, 1, 1) takes +Z to +X, +X to +Y and +Y to +Z.
DOME_ROTATION_WXYZ = (0.5, 0.5, 0.5, 0.5)


class Dome(NamedTuple):
    """A lat-long texture for each frame, named from the stage's folder, and what its values are multiplied by."""

    textures: list[str]
    intensity: float = 1.0


class UsdStage:
    """Takes frame after frame and writes the stage when it is complete."""

    def __init__(self, path: Path, dialect: UsdDialect = "standard", scale: float | None = None) -> None:
        """scale: luminance scale, cd/m2 per unit, by which intensities become lx; None: they stay as the irradiance is."""
        self.path, self.scale = path, scale
        self.dialect: UsdDialect = dialect
        self.dome: Dome | None = None
        self.columns = LightColumns(path.resolve().parent)

    def write(self) -> int:
        """Writes all frames that were added to `columns`; how many lights there are. Raises OSError when the disk refuses."""
        codes, rate = time_codes(self.columns.times_s)
        notes = {
            "vemlight:intensity": "irradiance as the lights have it" if self.scale is None else "lx",
            "vemlight:dialect": self.dialect,
            "vemlight:interpolation": "held",
        }
        with written_whole(self.path) as part, open(part, "wb") as file:
            kind = CrateLayer if self.path.suffix.lower() == ".usdc" else TextLayer
            layer: LayerWriter = kind(file, ROOT, LayerHead(codes, rate, notes))
            count = 0
            for lights in self.columns.lights():
                layer.prims("DistantLight", self._prims(lights, len(codes)))
                count += len(lights.ids)
            if self.dome:
                layer.prims("DomeLight", {"residual": _dome(self.dome)})
            layer.finish()
        return count

    def _prims(self, lights: LightRows, frame_count: int) -> dict[str, list[Attribute]]:
        """Name and attributes of each; what is calculated is so for all at once."""
        factors = DIALECTS[self.dialect]
        red, green, blue = lights.irradiance.T
        strength = np.maximum(np.maximum(red, green), blue)  # a fifth of the time of max(axis=1)
        colour = np.divide(lights.irradiance, strength[:, None], out=np.ones_like(lights.irradiance), where=strength[:, None] > 0)
        rotation = rotations_to(lights.directions)[:, [3, 0, 1, 2]].astype(np.float32)
        angle = lights.angles_deg / np.float32(factors.angle)
        intensity = _with_darkness(lights, strength.astype(np.float64) * (self.scale or 1.0) / factors.intensity, frame_count)
        prims: dict[str, list[Attribute]] = {}
        for k, number in enumerate(lights.ids.tolist()):
            rows, shown = slice(*lights.bounds[k : k + 2]), slice(*intensity.bounds[k : k + 2])
            here = lights.frames[rows]
            attributes = [
                Attribute("int64", "vemlight:id", number, is_custom=True),
                *OF_EACH,
                Attribute.of_frames("float", "inputs:intensity", intensity.frames[shown], intensity.values[shown]),
                Attribute.of_frames("color3f", "inputs:color", here, colour[rows]),
                Attribute.of_frames("float", "inputs:angle", here, angle[rows]),
                Attribute.of_frames("quatf", "xformOp:orient", here, rotation[rows]),
                ORDER,
            ]
            if self.scale is not None or self.dialect != "standard":
                attributes.append(Attribute.of_frames("color3f", "vemlight:irradiance", here, lights.irradiance[rows], is_custom=True))
            prims[f"light_{number:04d}"] = attributes
        return prims


def _dome(dome: Dome) -> list[Attribute]:
    """The rest of the light."""
    textures, frames = (dome.textures[0], None) if len(dome.textures) == 1 else (dome.textures, np.arange(len(dome.textures)))
    return [
        Attribute("float", "inputs:intensity", dome.intensity),
        Attribute("asset", "inputs:texture:file", textures, frames),
        Attribute("token", "inputs:texture:format", "latlong"),
        Attribute("quatf", "xformOp:orient", DOME_ROTATION_WXYZ),
        ORDER,
    ]


def time_codes(times_s: list[float]) -> tuple[np.ndarray, float]:
    """The time code (n,) float64 of each frame, 0 for the first, and how many there are in a second: the source's frame rate.

    The rate is a whole number or 1000/1001 of one where the times, which may have few decimals and gaps, allow it.
    """
    times = np.asarray(times_s, np.float64) - (times_s[0] if times_s else 0)
    if len(times) < 2:
        return times, DEFAULT_FPS
    frames = np.round(times / np.median(np.diff(times)))
    rate = float(frames[-1] / times[-1])
    whole = [round(rate), round(rate * 1.001) / 1.001]
    nearest = min(whole, key=lambda one: abs(one - rate))
    if abs(nearest / rate - 1) < TIME_ERROR_S / times[-1]:
        rate = nearest
    codes = times * rate
    return np.where(np.abs(codes - np.round(codes)) < ON_A_FRAME, np.round(codes), codes), rate


class _Samples(NamedTuple):
    """bounds: (lights + 1,), where each light's samples begin, and end. frames: (n,). values: (n,) float64."""

    bounds: np.ndarray
    frames: np.ndarray
    values: np.ndarray


def _with_darkness(lights: LightRows, strength: np.ndarray, frame_count: int) -> _Samples:
    """Samples of the intensity, which is 0 in the frames beside a light's life, so that it is dark in all where it is not."""
    span = frame_count + 2  # of each light's keys: its frames count from 1, so that one beside them is never another light's
    starts = span * np.arange(len(lights.bounds))
    keys = np.repeat(starts[:-1], np.diff(lights.bounds)) + lights.frames + 1
    before = keys[np.diff(keys, prepend=-2) > 1] - 1
    after = keys[np.diff(keys, append=keys[-1] + 3) > 2] + 1  # a gap of one frame is before the next already
    beside = np.sort(np.concatenate([before, after]))
    beside = beside[(beside % span > 0) & (beside % span <= frame_count)]
    at = np.searchsorted(keys, beside)
    bounds = lights.bounds + np.searchsorted(beside, starts)
    return _Samples(bounds, np.insert(lights.frames, at, beside % span - 1), np.insert(strength, at, 0.0))
