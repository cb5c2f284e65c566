"""The options of the commands that have many, as records: the command line builds them, and the commands read them.

None stands for an option that was left out. Imports nothing heavy, so that `vemlight --help` answers at once; values are checked
where they become settings.
"""

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

if TYPE_CHECKING:
    from vemlight.capture.calibration.response_fit import Kind
    from vemlight.capture.mosaic import Mosaic
    from vemlight.exchange.usd_file import UsdDialect

Options = TypeVar("Options", bound=msgspec.Struct)
Result = TypeVar("Result")


class SamplingOptions(msgspec.Struct, frozen=True, kw_only=True):
    """A source and how to sample it: what `lights` and `render` have in common."""

    source: str | Path  # a path, or the address of a stream
    count: int | None = None
    method: str | None = None
    coverage: str = "hemisphere"
    filter: str | None = None  # None: the method's own for sequences, none for a single map
    deflicker: bool | None = None
    fps: float | None = None
    frames: int | None = None
    layer: str | None = None
    lenses: tuple[Path, ...] = ()
    response: Path | None = None
    transfer: str | None = None
    primaries: str | None = None
    matrix: str | None = None
    range: str | None = None
    light: str | None = None
    peak: float | None = None
    projection: str | None = None
    span: tuple[float, float] | None = None
    stereo: str | None = None
    brackets: bool | None = None
    exposures: tuple[float, ...] | None = None
    exposure_control: str | None = None
    meter_lux: float | None = None
    format: str | None = None
    ground: float | None = None
    masks: Path | None = None
    controls: tuple[tuple[str, int], ...] = ()


class LightsOptions(SamplingOptions, frozen=True, kw_only=True):
    """The options of `vemlight lights`."""

    out: Path
    clusters: int | None = None
    error_percent: float | None = None
    soft: bool | None = None
    score: bool = False


class ArchiveOptions(SamplingOptions, frozen=True, kw_only=True):
    """The options of `vemlight archive`. index, indices: which of the chunks --maps-only makes: index, index + indices, ..."""

    out: Path
    workers: int | None = None
    chunk: int | None = None  # frames
    scheduler: str | None = None
    maps_only: bool = False
    from_maps: bool = False
    index: int | None = None
    indices: int | None = None
    clusters: int | None = None
    error_percent: float | None = None
    soft: bool | None = None


class LocateOptions(msgspec.Struct, frozen=True, kw_only=True):
    """The options of `vemlight locate`."""

    rig: Path
    out: Path
    subject: tuple[float, float, float] | None = None  # m
    count: int | None = None
    error_percent: float | None = None
    soft: bool | None = None
    coverage: str = "hemisphere"
    fps: float | None = None
    frames: int | None = None


class ExportOptions(SamplingOptions, frozen=True, kw_only=True):
    """The options of `vemlight export`. given: those that say how lights are made, as they were typed."""

    usd: Path | None = None
    gltf: Path | None = None
    mcap: Path | None = None
    usd_dialect: "UsdDialect" = "standard"
    frame: int = 0
    residual: bool = False
    error_percent: float | None = None
    soft: bool | None = None
    given: tuple[str, ...] = ()


class RenderOptions(SamplingOptions, frozen=True, kw_only=True):
    """The options of `vemlight render`. given: as ExportOptions has them."""

    out: Path | None = None
    video: Path | None = None
    scene: Path | None = None
    size: tuple[int, int] = (640, 480)  # width, height in pixels
    exposure: float = 0.0  # stops
    tone: str | None = None
    background: str | None = None
    shadow_map: int | None = None  # texels on a side
    shadows: str | None = None
    bounces: int = 1
    exr: str | None = None
    given: tuple[str, ...] = ()


class SimulateOptions(msgspec.Struct, frozen=True, kw_only=True):
    """The options of `vemlight simulate`."""

    maps: tuple[str, ...]
    lens: Path
    out: Path
    response: Path | None
    frames: int | None
    fps: float
    rotate_deg: float  # a frame, about the vertical
    keyframes: Path | None
    noise_codes: float
    pattern_codes: float
    mosaic: "Mosaic | None"
    exposure_s: float
    flicker_hz: float
    exposures: tuple[float, ...]
    control_delay: int
    sway: tuple[float, float]
    dropouts: float  # fraction of frames
    truth: bool
    seed: int


class LensOptions(msgspec.Struct, frozen=True, kw_only=True):
    """The options of `vemlight calibrate lens`."""

    images: tuple[Path, ...]
    out: Path
    board: tuple[int, int]  # inner corners: columns, rows
    square_m: float
    dictionary: str
    marker_m: float
    rim_deg: float
    accept: bool
    picture: Path | None


class ResponseOptions(msgspec.Struct, frozen=True, kw_only=True):
    """The options of `vemlight calibrate response`."""

    patches: Path
    out: Path
    kind: "Kind | None"
    bits: int | None
    accept: bool
    white_cd_m2: float | None
    corners: list[tuple[float, float]] | None  # pixels x, y
    picture: Path | None
    brackets: bool


def options_as(kind: type[Options]) -> Callable[[Callable[[Options], Result]], Callable[..., Result]]:
    """Hands a click command its parameters as one record of `kind`, whose fields have the parameters' names."""

    def decorate(command: Callable[[Options], Result]) -> Callable[..., Result]:
        @wraps(command)
        def with_record(**values: object) -> Result:
            return command(kind(**values))

        return with_record

    return decorate
