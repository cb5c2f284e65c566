"""The settings: frozen records, one a service, read once at start from one TOML file. An unknown key is an error.

Paths in the file are relative to it; after `read_settings` they are absolute.
"""

from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_type_hints

import msgspec
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import read_toml
from vemlight.light.sphere import Coverage
from vemlight.runtime.channels import SERVICES, Service

Count = Annotated[int, Meta(ge=1, le=100_000)]
Port = Annotated[int, Meta(ge=1, le=65_000)]
MAX_PICTURE_SIDE = 8192  # on a side of the picture
Side = Annotated[int, Meta(ge=1, le=MAX_PICTURE_SIDE)]
Mode = Literal["live", "lossless"]
Tone = Literal["reinhard", "exponential"]


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A section of the settings."""


class Wire(Record, frozen=True):
    """Where the services meet: sockets in a private folder of this machine, or tcp between hosts."""

    transport: Literal["ipc", "tcp"] = "ipc"
    folder: str = ""  # of the ipc sockets; empty: a folder of this user's, made with mode 0700
    hosts: dict[Service, str] = {}  # tcp: where each service runs; 127.0.0.1 when left out
    port: Port = 5600  # tcp: the first of the ten ports in use
    keys: str = ""  # tcp: folder with the CURVE keys of `vemlight keys`
    insecure: bool = False  # tcp without keys


class Capture(Record, frozen=True):
    source: str = ""  # lat-long .hdr or .exr, a folder of them, a recorded sequence, or /dev/videoN; empty: the bundled sequence
    lens: str = ""  # fisheye sequences: the lens file
    response: str = ""  # raw fisheye frames: the response file
    fps: Annotated[float, Meta(gt=0, le=1000)] = 25.0
    rows: Annotated[int, Meta(ge=2, le=4096)] = 90
    cols: Annotated[int, Meta(ge=4, le=8192)] = 360
    coverage: Coverage = "hemisphere"
    frames: Annotated[int, Meta(ge=0)] = 0  # stop after so many; 0: all of them, again and again in live mode
    start: Annotated[int, Meta(ge=0)] = 0  # files: the first frame to play
    end: Annotated[int, Meta(ge=0)] = 0  # files: the one to stop before; 0: to the last
    speed: Annotated[float, Meta(gt=0, le=100)] = 1.0  # files: times their own rate
    format: str = ""  # cameras: the kernel's four letters, such as Y12 or RG10; empty: the deepest one. PNG frames: their mosaic
    width: Annotated[int, Meta(ge=0, le=16384)] = 0  # cameras: what to ask for; 0: the lens file's size
    height: Annotated[int, Meta(ge=0, le=16384)] = 0
    record: str = ""  # folder to record to; empty: nothing is recorded
    threads: Annotated[int, Meta(ge=1, le=8)] = 1  # fisheye frames: that share the work; more are for images above 2 megapixels


class Sampler(Record, frozen=True):
    method: Literal["tracked", "havran-azimuth", "havran-radius", "standard"] = "tracked"
    points: Literal["auto", "disc", "relaxed", "halton"] = "auto"  # not "tracked"; auto: "standard" relaxed, the others disc
    count: Count = 72  # lights; the most of them where error_percent or the renderer's frame_ms chooses
    filter: Literal["auto", "adaptive", "fir2005", "fir", "binomial", "iir", "none"] = "auto"  # auto: "tracked" adaptive, others fir2005
    order: Annotated[int, Meta(ge=2, le=64, multiple_of=2)] = 8  # "fir": frames it looks back; the delay is half of them
    pass_hz: Annotated[float, Meta(gt=0, le=500)] = 3.0  # "fir": kept up to here; "iir": half the power left here
    stop_hz: Annotated[float, Meta(gt=0, le=500)] = 6.0  # "fir": removed from here on
    deflicker: bool = False  # take mains flicker out of the total power
    clusters: Annotated[int, Meta(ge=0, le=100_000)] = 0  # most lights after merging neighbours; 0: no merging
    gloss_lights: Annotated[int, Meta(ge=0, le=100_000)] = 0  # in the gloss set, a second, larger set for glossy surfaces; 0: none
    error_percent: Annotated[float, Meta(ge=0, le=100)] = 0.0  # as many lights as keep the irradiance within this of the map's; 0: `count`

    def __post_init__(self) -> None:
        if self.filter not in ("auto", "none") and (self.method == "tracked") != (self.filter == "adaptive"):
            raise ValueError(f"filter {self.filter} does not go with method {self.method}; name another method, or filter auto")


class Renderer(Record, frozen=True):
    scene: str = ""  # scene file; empty: the bundled one
    width: Side = 640
    height: Side = 480
    # Texels on a side of each light's shadow map; left out: 64 to 1024, by the light's share of the power.
    shadow_map: Annotated[int, Meta(ge=16, le=4096)] | None = None
    # Live: met by fewer and coarser shadow maps a frame, then fewer lights; 0: no target; left out: 100, ten pictures a second.
    frame_ms: Annotated[float, Meta(ge=0, le=10_000)] | None = None
    # Of the sphere of normals, each with the lights it sees; 0: none; left out: 24 for light from all sides, none for a hemisphere.
    light_regions: Annotated[int, Meta(ge=0, le=256)] | None = None
    exposure: Annotated[float, Meta(ge=-20, le=20)] = 0.0  # stops, on top of the tone mapping's own
    tone: Tone = "reinhard"  # the curve of the tone mapping
    background: Literal["clear", "map"] = "clear"  # behind the scene: nothing, with alpha 0, or the light around
    video: str = ""  # file to make of all pictures at the end, .mp4, .mov or .mkv; needs `out`; empty: none
    picture: Literal["srgb8", "linear16"] = "srgb8"  # linear16: for other programs also the picture before tone mapping, as half floats


class Plate(Record, frozen=True):
    """A second camera, whose picture stands behind the scene."""

    source: str = ""  # a film, a folder of pictures, or /dev/videoN; empty: there is none
    fps: Annotated[float, Meta(gt=0, le=1000)] = 25.0  # folders of pictures; films have their own
    stops: Annotated[float, Meta(ge=-20, le=20)] = 0.0  # brighter or darker, to fit the lights


class Viewer(Record, frozen=True):
    host: str = "127.0.0.1"  # this machine only; 0.0.0.0: everyone on the network who has the token
    port: Port = 8080
    # Asked for when it is set; left out: none on this machine only, else a new one at each start, in the address that is printed.
    token: Annotated[str, Meta(pattern="^([A-Za-z0-9_-]{16,128})?$")] = ""
    insecure: bool = False  # everyone who reaches the page may see and steer, without a token
    names: tuple[str, ...] = ()  # under which browsers may ask for the page, beside numbers, localhost and this machine's name

    def __post_init__(self) -> None:
        if self.token and self.insecure:
            raise ValueError("token and insecure exclude each other; take one of them out")


class Settings(Record, frozen=True):
    mode: Mode = "live"
    out: str = ""  # folder for lights (.jsonl) and pictures (EXR and PNG); empty: nothing is written
    wire: Wire = Wire()
    capture: Capture = Capture()
    sampler: Sampler = Sampler()
    renderer: Renderer = Renderer()
    viewer: Viewer = Viewer()
    plate: Plate = Plate()

    @property
    def services(self) -> tuple[Service, ...]:
        """Those that run."""
        return tuple(service for service in SERVICES if service != "plate" or self.plate.source)


_PATHS = {
    "": ("out",),
    "wire": ("folder", "keys"),
    "capture": ("source", "lens", "response", "record"),
    "renderer": ("scene", "video"),
    "plate": ("source",),
}


def read_settings(path: Path | None) -> Settings:
    """The settings at `path` with absolute paths, or the defaults. Raises UserError naming file and key."""
    settings = read_toml(path, Settings) if path else Settings()
    folder = path.resolve().parent if path else Path.cwd()
    for section, keys in _PATHS.items():
        record = getattr(settings, section) if section else settings
        full = {key: str(folder / value) for key in keys if (value := getattr(record, key))}
        if section:
            settings = msgspec.structs.replace(settings, **{section: msgspec.structs.replace(record, **full)})
        else:
            settings = msgspec.structs.replace(settings, **full)
    check_settings(settings, path)
    return settings


def check_settings(settings: Settings, path: Path | None = None) -> None:
    """Raises UserError for values that each are legal but not together."""
    where = path or "settings"
    if settings.wire.transport == "tcp" and not settings.wire.keys and not settings.wire.insecure:
        raise UserError(f"{where}: [wire] transport = \"tcp\" needs keys = FOLDER (made by `vemlight keys`) or insecure = true")
    for source in (settings.capture.source, settings.plate.source):
        if settings.mode == "lossless" and is_camera(source):
            raise UserError(f"{where}: mode = \"lossless\" replays files and {source} is a camera; use mode = \"live\"")


def is_camera(source: str) -> bool:
    """Whether a source is a camera of the kernel, whose frames come as they are taken, and not files, which are replayed.

    /dev/videoN and the lasting names under /dev/v4l are cameras; /dev/shm is a folder in memory.
    """
    return source.startswith("/dev/") and not source.startswith("/dev/shm/")


Section = TypeVar("Section", bound=Record)


def record(kind: type[Section], values: dict[str, Any], prefix: str) -> Section:
    """A section made of `values`; None means the default. Raises UserError naming the option, as `prefix` and its key."""
    given = {key: str(value) if isinstance(value, Path) else value for key, value in values.items() if value is not None}
    try:
        return msgspec.convert(given, kind)
    except msgspec.ValidationError as error:
        text, _, where = str(error).partition(" - at `$.")
        if not where:  # values that do not go together; the text says how to mend them
            raise UserError(text) from error
        key = where.rstrip("`")
        choices = get_args(get_type_hints(kind).get(key))
        known = f"; choose from {', '.join(map(str, choices))}" if choices else ""
        raise UserError(f"{prefix}{key}: {text[:1].lower()}{text[1:]}{known or '; change that option'}") from error
