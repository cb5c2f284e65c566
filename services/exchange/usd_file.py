"""Lights as a USD stage: z up, metres, a DistantLight for each id below `/vemlight`, its values as samples at the frames it lives in.

UsdLux: with `normalize` a DistantLight gives a plane that faces it `intensity x 2^exposure x color`, and shines along its -Z. Text (.usda)
is written here; for .usdc usd-core reads it in pieces and encodes it, so that memory does not grow with the recording.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

import msgspec
import numpy as np

from vemlight.errors import UserError
from vemlight.exchange.light_columns import LightColumns, LightSeries
from vemlight.exchange.punctual import rotations_to
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
PIECE_FRAMES = 10_000  # of lights in a piece of a .usdc: with four values each 10 MB; 5,000 to 20,000 would do
BRACKETS = bytes.maketrans(b"[]", b"()")
ROOT = "/vemlight"
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
        """scale: luminance scale, cd/m2 per unit, by which intensities become lx; None: they stay as the irradiance is. Raises UserError
        without usd-core for a .usdc."""
        self.path, self.scale = path, scale
        self.dialect: UsdDialect = dialect
        self.dome: Dome | None = None
        self.columns = LightColumns(path.resolve().parent)
        self._layers = _sdf() if path.suffix.lower() == ".usdc" else None

    def write(self) -> int:
        """Writes all frames that were added to `columns`; how many lights there are. Raises OSError when the disk refuses."""
        with written_whole(self.path) as part:
            if self._layers is None:
                with open(part, "wb") as file:
                    return self._write_text(file)
            return self._write_crate(self._layers, part)

    def _write_text(self, file: BinaryIO) -> int:
        codes, rate = time_codes(self.columns.times_s)
        count = 0
        file.write(self._header(codes, rate))
        for series in self.columns.series():
            file.write(self._light(series, codes))
            count += 1
        file.write(self._dome_text(codes) + b"}\n")
        return count

    def _write_crate(self, sdf: Any, part: Path) -> int:
        """By pieces of text: usd-core keeps a layer's new values in memory until it is saved, and reads saved ones from the file."""
        codes, rate = time_codes(self.columns.times_s)
        part.unlink(missing_ok=True)
        try:
            stage = sdf.Layer.CreateNew(str(part), args={"format": "usdc"})
            head = sdf.Layer.CreateAnonymous(".usda")
            head.ImportFromString((self._header(codes, rate) + self._dome_text(codes) + b"}\n").decode())
            stage.TransferContent(head)
            count = 0
            for text, lights in self._pieces(codes):
                piece = sdf.Layer.CreateAnonymous(".usda")
                piece.ImportFromString(text.decode())
                for prim in piece.GetPrimAtPath(ROOT).nameChildren:
                    sdf.CreatePrimInLayer(stage, prim.path)
                    sdf.CopySpec(piece, prim.path, stage, prim.path)
                stage.Save()
                count += lights
            stage.Save()
        except Exception as error:  # Tf.ErrorException, whose text has lines
            raise OSError(f"{self.path}: usd-core could not write it ({' '.join(str(error).split())[:160]})") from error
        return count

    def _pieces(self, codes: np.ndarray) -> Iterator[tuple[bytes, int]]:
        begin, end = b'#usda 1.0\ndef Xform "vemlight" {\n', b"}\n"
        texts: list[bytes] = []
        samples = 0
        for series in self.columns.series():
            texts.append(self._light(series, codes))
            samples += len(series.frames)
            if samples > PIECE_FRAMES:
                yield begin + b"".join(texts) + end, len(texts)
                texts, samples = [], 0
        if texts:
            yield begin + b"".join(texts) + end, len(texts)

    def _header(self, codes: np.ndarray, rate: float) -> bytes:
        unit = "irradiance as the lights have it" if self.scale is None else "lx"
        times = f"    startTimeCode = 0\n    endTimeCode = {codes[-1]:.17g}\n" if len(codes) > 1 else ""
        return (
            '#usda 1.0\n(\n    defaultPrim = "vemlight"\n    upAxis = "Z"\n    metersPerUnit = 1\n'
            f"    timeCodesPerSecond = {rate:.17g}\n    framesPerSecond = {rate:.17g}\n{times}"
            f'    customLayerData = {{\n        string "vemlight:intensity" = "{unit}"\n'
            f'        string "vemlight:dialect" = "{self.dialect}"\n'
            '        string "vemlight:interpolation" = "held"\n    }\n)\n\ndef Xform "vemlight"\n{\n'
        ).encode()

    def _light(self, series: LightSeries, codes: np.ndarray) -> bytes:
        factors = DIALECTS[self.dialect]
        strength = series.irradiance.max(axis=1)
        colour = np.divide(series.irradiance, strength[:, None], out=np.ones_like(series.irradiance), where=strength[:, None] > 0)
        rotation = rotations_to(series.directions)[:, [3, 0, 1, 2]].astype(np.float32)
        here = codes[series.frames].tolist()
        lines = [
            f'    def DistantLight "light_{series.id:04d}"\n    {{\n        custom int64 vemlight:id = {series.id}\n'.encode(),
            b"        bool inputs:normalize = 1\n        float inputs:exposure = 0\n        bool inputs:enableColorTemperature = 0\n",
            _intensity(series.frames, strength.astype(np.float64) * (self.scale or 1.0) / factors.intensity, codes),
            _value("color3f inputs:color", here, colour),
            _value("float inputs:angle", here, series.angles_deg / np.float32(factors.angle)),
            _value("quatf xformOp:orient", here, rotation),
            b'        uniform token[] xformOpOrder = ["xformOp:orient"]\n    }\n\n',
        ]
        if self.scale is not None or self.dialect != "standard":
            lines.insert(2, _value("custom color3f vemlight:irradiance", here, series.irradiance))
        return b"".join(lines)

    def _dome_text(self, codes: np.ndarray) -> bytes:
        """The rest of the light as a dome; empty where there is none."""
        if self.dome is None:
            return b""
        names = [msgspec.json.encode(name).decode()[1:-1] for name in self.dome.textures]
        if len(names) == 1:
            texture = f"asset inputs:texture:file = @{names[0]}@"
        else:
            samples = ", ".join(f"{code:.17g}: @{name}@" for code, name in zip(codes.tolist(), names, strict=True))
            texture = f"asset inputs:texture:file.timeSamples = {{ {samples} }}"
        return (
            f'    def DomeLight "residual"\n    {{\n        float inputs:intensity = {self.dome.intensity:.9g}\n'
            f'        {texture}\n        token inputs:texture:format = "latlong"\n        quatf xformOp:orient = {DOME_ROTATION_WXYZ}\n'
            '        uniform token[] xformOpOrder = ["xformOp:orient"]\n    }\n'
        ).encode()


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


def _intensity(frames: np.ndarray, strength: np.ndarray, codes: np.ndarray) -> bytes:
    """Samples of the intensity, which is 0 in the frames beside a light's life, so that it is dark in all where it is not."""
    beside = np.setdiff1d(np.concatenate([frames - 1, frames + 1]), frames)
    beside = beside[(beside >= 0) & (beside < len(codes))]
    order = np.argsort(np.concatenate([frames, beside]), kind="stable")
    times = codes[np.concatenate([frames, beside])[order]].tolist()
    values = np.concatenate([strength, np.zeros(len(beside))])[order]
    return _value("float inputs:intensity", times, values)


def _value(name: str, times: list[float], values: np.ndarray) -> bytes:
    """A line of usda: samples, or a single value where it never changes."""
    if (values == values[0]).all():
        return f"        {name} = ".encode() + _usda(values[0].tolist()) + b"\n"
    samples = dict(zip(times, values.tolist(), strict=True))
    return f"        {name}.timeSamples = ".encode() + _usda(samples).translate(None, b'"') + b"\n"


def _usda(value: Any) -> bytes:
    """As JSON has it, with round brackets."""
    return msgspec.json.encode(value).translate(BRACKETS)


def _sdf() -> Any:
    try:
        from pxr import Sdf  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UserError(
            "--usd: a .usdc is written by usd-core, which is not installed; pip install 'vemlight[export]', or name it .usda"
        ) from error
    return Sdf
