"""The settings: frozen records, one a service, read once at start from one TOML file (`vemlight.settings_file`). An unknown key is an
error.

Each key is declared here once: type, default, range, unit and meaning; docs/settings.md is made from it. Paths in the file are relative
to it; after `read_settings` they are absolute.
"""

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from vemlight.choices import (
    Background,
    ExrFloats,
    Filter,
    LightOf,
    Matrix,
    Method,
    Mode,
    Primaries,
    Projection,
    Range,
    Shadows,
    Stereo,
    Tone,
)
from vemlight.light.mask import MAX_MASKS, Mask, check_masks
from vemlight.light.measured_lamp import MAX_MEASURED, MeasuredLamp
from vemlight.light.sphere import Coverage
from vemlight.light.virtual_lamp import MAX_LAMPS, VirtualLamp, check_lamps
from vemlight.runtime.channels import SERVICES, Service
from vemlight.runtime.poses import MAX_POSES, Pose, View
from vemlight.runtime.wire_fields import Lux
from vemlight.setting_keys import (
    CD_M2,
    FPS,
    FRAMES,
    HZ,
    LUX,
    MB,
    MS,
    PATH,
    PER_CENT,
    PIXELS,
    STOPS,
    TEXELS,
    Count,
    Count0,
    ExposureTimes,
    Frequency,
    InstanceName,
    Port,
    Rate,
    Side,
    Stops,
    means,
)
from vemlight.source_names import is_camera, is_live


class SettingsSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A section of the settings file."""


class Wire(SettingsSection, frozen=True):
    """How the services reach each other: sockets in a private folder of this machine, or TCP between hosts."""

    transport: Annotated[Literal["ipc", "tcp"], means("sockets in a folder of this machine, or TCP between hosts")] = "ipc"
    folder: Annotated[str, means("folder of the ipc sockets; empty: one of this user's, made with mode 0700"), PATH] = ""
    hosts: Annotated[dict[str, str], means("tcp: the host on which each service runs; 127.0.0.1 when left out")] = {}
    port: Annotated[Port, means("tcp: the first of the fourteen ports in use")] = 5600
    ports: Annotated[
        dict[str, Port],
        means('tcp: the first of two ports of each camera of a rig, and of others with a name, such as "capture.left" = 5620'),
    ] = {}
    names: Annotated[
        dict[Service, InstanceName],
        means('what services are called where there are several of a kind, such as renderer = "renderer.b"; left out: as their kind'),
    ] = {}
    elsewhere: Annotated[
        tuple[Service, ...], means("services that another run has started; this one starts the others and uses those")
    ] = ()
    renderers: Annotated[
        tuple[InstanceName, ...],
        means("live: renderers by whose frame time the sampler chooses how many lights it makes, as the fastest of them; empty: the one of "
              "this run"),
    ] = ()  # fmt: skip
    keys: Annotated[str, means("tcp: folder with the CURVE keys of `vemlight keys`"), PATH] = ""
    insecure: Annotated[bool, means("tcp: allow connections without keys")] = False


class Capture(SettingsSection, frozen=True):
    """Where the light comes from, and the polar map that is made of it."""

    source: Annotated[
        str, means("lat-long .hdr or .exr, a folder of them, a recording, /dev/videoN, genicam:SERIAL; empty: the bundled sequence"), PATH
    ] = ""
    lens: Annotated[
        str | tuple[str, ...], means("fisheye frames: the lens file, or a list of several lenses'; empty: lens.toml beside them"), PATH
    ] = ""
    response: Annotated[str, means("raw fisheye frames: the response file; empty: response.toml beside them"), PATH] = ""
    layer: Annotated[str, means("EXR files with several layers or parts: the name of the one to read; empty: the picture itself")] = ""
    fps: Annotated[Rate, means("frame rate of sources whose files do not state one"), FPS] = 25.0
    rows: Annotated[int, Meta(ge=2, le=4096), means("rows of the polar map, equal in elevation"), PIXELS] = 90
    cols: Annotated[int, Meta(ge=4, le=8192), means("columns of the polar map, equal in azimuth"), PIXELS] = 360
    coverage: Annotated[Coverage, means("the part of the sphere of directions that the map covers")] = "hemisphere"
    ground: Annotated[
        Annotated[float, Meta(ge=0, le=1)],
        means("hemisphere: albedo of a ground below the horizon, which sends the map's light up; 0: none, no light comes from below"),
    ] = 0.0
    frames: Annotated[int, Meta(ge=0), means("stop after so many; 0: all of them, again and again in live mode"), FRAMES] = 0
    start: Annotated[int, Meta(ge=0), means("files: number of the first frame to play")] = 0
    end: Annotated[int, Meta(ge=0), means("files: number of the frame to stop before; 0: play to the last")] = 0
    speed: Annotated[float, Meta(gt=0, le=100), means("files: playback rate, as a multiple of their own")] = 1.0
    format: Annotated[
        str,
        means("cameras: pixel format by the kernel's letters, such as Y12, RG10, YUYV, MJPG, or GenICam's name, such as Mono12p; empty: "
              "with a response file the one with the most bits (GenICam: with its bits), else the best in colour. PNG: its mosaic"),
    ] = ""  # fmt: skip
    controls: Annotated[
        dict[str, int], means("cameras: controls to set, such as gain = 50, by the names that `vemlight doctor` lists; GenICam: features")
    ] = {}
    width: Annotated[int, Meta(ge=0, le=16384), means("cameras: frame width to ask for; 0: the lens file's (GenICam: own)"), PIXELS] = 0
    height: Annotated[int, Meta(ge=0, le=16384), means("cameras: frame height to ask for; 0: the lens file's (GenICam: own)"), PIXELS] = 0
    transfer: Annotated[
        str,
        means("curve of films, cameras in colour, PNG, JPEG: srgb, bt709, bt1886, pq, hlg, linear, logc3, logc4, slog3, vlog, acescct, or "
              "ocio:NAME; empty: as their tags say"),
    ] = ""  # fmt: skip
    primaries: Annotated[Primaries | None, means("primaries of their colours; left out: as the tags say, or the curve implies")] = None
    matrix: Annotated[Matrix | None, means("matrix of their luma and chroma; left out: as the tags say")] = None
    range: Annotated[Range | None, means("codes of black and white: 16 and 235 of 255, or 0 and 255; left out: as the tags say")] = None
    light: Annotated[LightOf | None, means("hlg, bt709: light of the scene, or of the display; left out: the scene's")] = None
    peak: Annotated[
        Annotated[float, Meta(gt=0, le=100_000)] | None, means('hlg with light = "display": peak of the display; left out: 1000'), CD_M2
    ] = None
    projection: Annotated[
        Projection | None, means("where pixels look; left out: fisheye with a lens, else equirect, which is then twice as wide as high")
    ] = None
    span: Annotated[
        tuple[Annotated[float, Meta(gt=0, le=360)], Annotated[float, Meta(gt=0, le=180)]] | None,
        means("equirect: degrees across and down that the image covers, the middle of the sphere; left out: 360, 180"),
    ] = None
    stereo: Annotated[Stereo | None, means("films for two eyes: how they lie; the first is taken; left out: as the film says")] = None
    exposures: Annotated[
        ExposureTimes, means("cameras: exposures to take in turn and to merge, such as [0.008, 0.0005, 0.00003] s; empty: one")
    ] = ()
    exposure_control: Annotated[
        str, means("cameras: the control that sets them; other than exposure_time_absolute (and GenICam's own), exposures are its counts")
    ] = "exposure_time_absolute"
    meter_lux: Annotated[
        Lux, means("reading of a light meter that lies level beside the camera: clipped light is estimated by it; 0: no estimate"), LUX
    ] = 0.0
    brackets: Annotated[bool, means("folders of photographs: several exposures, by their EXIF, are one frame")] = False
    record: Annotated[str, means("folder to record to; empty: nothing is recorded"), PATH] = ""
    recordings: Annotated[
        str, means("folder whose recordings, films and maps the page offers to play, and to which it records; empty: none"), PATH
    ] = ""
    masks: Annotated[
        Annotated[tuple[Mask, ...], Meta(max_length=MAX_MASKS)],
        means("`[[capture.masks]]`, regions left out of the map: points = [[azimuth, elevation], ..] in degrees, mode = \"fill\" or "
              "\"dark\", width_deg of a stroke"),
    ] = ()  # fmt: skip
    threads: Annotated[int, Meta(ge=1, le=8), means("threads that resample a fisheye frame; more than 1 pays off above 2 megapixels")] = 1

    @property
    def lenses(self) -> tuple[str, ...]:
        """The lens files that are named."""
        return tuple(filter(None, (self.lens,))) if isinstance(self.lens, str) else self.lens

    @property
    def map_coverage(self) -> Coverage:
        """The part of the sphere that the maps cover which leave the capture: with a ground all of it."""
        return "sphere" if self.ground else self.coverage

    def __post_init__(self) -> None:
        check_masks(self.masks)
        if self.ground and self.coverage == "sphere":
            raise ValueError("ground is the lower half of a hemisphere, and coverage sphere has its own; leave one of them out")
        if self.lenses and self.projection in ("equirect", "cube3x2"):
            raise ValueError(f"lens is for fisheye frames and projection is {self.projection}; leave one of them out")
        if self.span and (self.projection in ("fisheye", "cube3x2") or self.lenses):
            raise ValueError("span is for projection equirect; leave one of them out")
        if self.brackets and is_live(self.source):
            raise ValueError("brackets is for folders of photographs; a camera takes exposures")
        if self.exposures and not is_camera(self.source):
            raise ValueError("exposures is for cameras; a folder of photographs has brackets, and a recording says its own")
        if self.exposures and self.exposure_control in self.controls:
            raise ValueError(f"controls and exposures both set {self.exposure_control}; leave one of them out")
        if self.stereo and len(self.lenses) > 1:
            raise ValueError("stereo is of films for two eyes, and several lens files are for one view of all; leave one of them out")


KEPT = ("fps", "rows", "cols", "coverage", "ground", "masks", "threads")  # of [capture], for a source that is not the settings' own


def chosen_capture(own: Capture, source: str) -> Capture:
    """The section for a source that the settings do not name: how maps are made, and nothing of how their own source is read."""
    return Capture(source=source, **{key: getattr(own, key) for key in KEPT})


FIXED_COUNT = 72  # the number of Havran et al. 2005
ADAPTIVE_PERCENT = 5.0  # 20 to 80 soft lights: what one sees of fewer is in docs/accuracy.md
ADAPTIVE_COUNT = 256  # three times what any of eleven maps takes for that; a limit of 3 % takes 130


class Rig(SettingsSection, frozen=True):
    """Several cameras that see the light of one place, in the place of `[capture] source`."""

    file: Annotated[str, means("rig file of the cameras, .toml; empty: there is one camera, `[capture] source`"), PATH] = ""


class Sampler(SettingsSection, frozen=True):
    """How lights are chosen from a map and kept steady."""

    method: Annotated[Method, means("sampling method")] = "tracked"
    points: Annotated[
        Literal["auto", "disc", "relaxed", "halton"], means("point set of all methods but tracked; auto: relaxed for standard, else disc")
    ] = "auto"
    count: Annotated[
        Count | None,
        means("lights a frame; the maximum where error_percent or the renderer's frame_ms chooses; left out: 256 under an error limit, "
              "else 72"),
    ] = None  # fmt: skip
    filter: Annotated[Filter, means("temporal filter; auto: adaptive for tracked, fir2005 for the others")] = "auto"
    order: Annotated[int, Meta(ge=2, le=64, multiple_of=2), means("fir: earlier frames in the sum; the delay is half of them"), FRAMES] = 8
    pass_hz: Annotated[Frequency, means("fir: end of the pass band; iir: half of the power passes here"), HZ] = 3.0
    stop_hz: Annotated[Frequency, means("fir: start of the stop band"), HZ] = 6.0
    soft: Annotated[
        bool | None,
        means("lights carry the extent of their light: by rays shadows have its penumbrae, by maps four points stand for each; left out: "
              "true for tracked lights"),
    ] = None
    deflicker: Annotated[bool, means("remove mains flicker of lamps where its beat is found beyond doubt")] = True
    clusters: Annotated[Count0, means("maximum number of lights after merging neighbours; 0: no merging")] = 0
    gloss_lights: Annotated[
        Count0, means("lights of a second, larger set for programs that draw gloss by lights; the renderer reflects the map; 0: none")
    ] = 0
    error_percent: Annotated[
        Annotated[float, Meta(ge=0, le=100)] | None,
        means("use as few lights as keep the error of irradiance within this limit; 0: always `count`; left out: 5 for soft lights without "
              "`count`, else 0"),
        PER_CENT,
    ] = None  # fmt: skip
    lamp: Annotated[
        Annotated[tuple[VirtualLamp, ...], Meta(max_length=MAX_LAMPS)],
        means("`[[sampler.lamp]]`, virtual lamps added to the lights: id, azimuth_deg, elevation_deg, irradiance = [r, g, b] of a plane "
              "facing it, size_deg"),
    ] = ()  # fmt: skip

    @property
    def is_soft(self) -> bool:
        """Whether lights have extents; only those of method tracked can."""
        return self.soft if self.soft is not None else self.method == "tracked"

    @property
    def error_limit(self) -> float:
        """Relative error that as few lights as possible keep within; 0: there are `max_count`."""
        chosen = self.error_percent if self.error_percent is not None else ADAPTIVE_PERCENT if self.is_soft and self.count is None else 0.0
        return chosen / 100

    @property
    def max_count(self) -> int:
        """The most lights of a frame."""
        return self.count or (ADAPTIVE_COUNT if self.error_limit else FIXED_COUNT)

    def __post_init__(self) -> None:
        check_lamps(self.lamp)
        if self.filter not in ("auto", "none") and (self.method == "tracked") != (self.filter == "adaptive"):
            raise ValueError(f"filter {self.filter} does not go with method {self.method}; name another method, or filter auto")
        if self.filter == "fir" and self.pass_hz >= self.stop_hz:
            raise ValueError(f"filter fir stops from {self.stop_hz:g} Hz on what passes to {self.pass_hz:g} Hz; set pass_hz below stop_hz")
        if self.soft and self.method != "tracked":
            raise ValueError(f"soft lights are made by method tracked, not {self.method}; leave out soft or name method tracked")


class Renderer(SettingsSection, frozen=True):
    """What is drawn, and within which time."""

    scene: Annotated[str, means("scene file; empty: the bundled scene"), PATH] = ""
    width: Annotated[Side, means("width of the picture"), PIXELS] = 640
    height: Annotated[Side, means("height of the picture"), PIXELS] = 480
    shadow_map: Annotated[
        Annotated[int, Meta(ge=16, le=4096)] | None,
        means("side of each light's shadow map; left out: 64 to 1024, by the light's fraction of the power"),
        TEXELS,
    ] = None
    frame_ms: Annotated[
        Annotated[float, Meta(ge=0, le=10_000)] | None,
        means("live: target of a frame, met by fewer and coarser shadow maps, then fewer lights; 0: no target; left out: 100"),
        MS,
    ] = None
    shadows: Annotated[
        Shadows,
        means("by rays, exact, or by maps, fast on a GPU; auto: rays where the processor draws and `shadow_map` is left out"),
    ] = "auto"
    bounces: Annotated[
        Annotated[int, Meta(ge=0, le=1)],
        means("of light from surface to surface; drawn where shadows are by rays and, live, while the frame time allows"),
    ] = 1
    light_regions: Annotated[
        Annotated[int, Meta(ge=0, le=256)] | None,
        means("regions of the sphere of normals, each with a list of the lights above its horizon; 0: none; left out: 24 for light from "
              "all sides, none for a hemisphere"),
    ] = None  # fmt: skip
    exposure: Annotated[Stops, means("exposure, added to that of the tone mapping"), STOPS] = 0.0
    tone: Annotated[Tone, means("curve of the tone mapping")] = "reinhard"
    background: Annotated[Background, means("behind the scene: nothing, with alpha 0, or the environment map")] = "clear"
    video: Annotated[str, means("file to write all pictures to at the end, .mp4, .mov or .mkv; requires `out`; empty: none"), PATH] = ""
    exr: Annotated[ExrFloats, means("numbers of EXR files; half: 32-bit floats still where a number is beyond 65,504")] = "half"
    camera: Annotated[
        View | None, means("`[renderer.camera]`, from where the scene is seen instead of its own camera: from, at, fov_y (degrees)")
    ] = None
    poses: Annotated[
        Annotated[tuple[Pose, ...], Meta(max_length=MAX_POSES)],
        means("`[[renderer.poses]]`, where objects and lamps of the scene stand instead: name, position, rotation (quaternion x y z w), "
              "power of lamps, scale of objects"),
    ] = ()  # fmt: skip
    lamp: Annotated[
        Annotated[tuple[MeasuredLamp, ...], Meta(max_length=MAX_MEASURED)],
        means("`[[renderer.lamp]]`, measured lamps that take the place of near lights: file (.ies, .ldt, .exr), at, within_m of which a "
              "near light is this lamp, rotate (degrees about x, y, z), lamp_set"),
    ] = ()  # fmt: skip
    picture: Annotated[Literal["srgb8", "linear16"], means("linear16: also send the picture before tone mapping, as half floats")] = "srgb8"

    def __post_init__(self) -> None:
        if self.shadows == "rays" and self.shadow_map is not None:
            raise ValueError("shadow_map is the resolution of maps, and shadows are by rays; leave one of them out")


class Plate(SettingsSection, frozen=True):
    """A second camera, whose picture is the background of the scene."""

    source: Annotated[str, means("a video, a folder of pictures, or /dev/videoN; empty: there is none"), PATH] = ""
    fps: Annotated[Rate, means("frame rate of a folder of pictures; videos have their own"), FPS] = 25.0
    stops: Annotated[Stops, means("exposure of the plate, to match the lights"), STOPS] = 0.0


class Fixtures(SettingsSection, frozen=True):
    """Real fixtures that are driven by the light."""

    rig: Annotated[str, means("rig file, .toml or .mvr; empty: there is none"), PATH] = ""
    arm: Annotated[bool, means("send live from the start; else a preview, which no fixture shows, until the page arms it")] = False
    blackout: Annotated[bool, means("send darkness before the end; else the last look, and word that the source ends")] = False

    def __post_init__(self) -> None:
        if self.arm and not self.rig:
            raise ValueError("arm is for a rig and there is none; set rig = FILE, or leave out arm")


class Viewer(SettingsSection, frozen=True):
    """The page that shows and controls it all."""

    host: Annotated[
        str, means("address to listen at; 127.0.0.1: this machine only; 0.0.0.0: everyone on the network who has the token")
    ] = "127.0.0.1"
    port: Annotated[Port, means("TCP port of the page")] = 8080
    token: Annotated[
        str,
        Meta(pattern="^([A-Za-z0-9_-]{16,128})?$"),
        means("required to open the page when set; empty: none for this machine only, else a new one at each start, which is printed"),
    ] = ""
    insecure: Annotated[bool, means("let everyone who reaches the page see and control, without a token")] = False
    uploads_mb: Annotated[
        int, Meta(ge=0, le=100_000), means("what files dropped on the page may take together, until the run ends; 0: none are taken"), MB
    ] = 512
    names: Annotated[
        tuple[str, ...], means("host names under which browsers may ask for the page, besides numbers, localhost and this machine's name")
    ] = ()
    origins: Annotated[
        tuple[Annotated[str, Meta(pattern=r"^https?://[^/\s]+$")], ...],
        means('web pages elsewhere that may open the page\'s websocket, such as "https://stage.example:8443"'),
    ] = ()

    def __post_init__(self) -> None:
        if self.token and self.insecure:
            raise ValueError("token and insecure exclude each other; take one of them out")


class Settings(SettingsSection, frozen=True):
    """The settings of one run."""

    mode: Annotated[Mode, means("live: the newest frame wins; lossless: every frame, in order")] = "live"
    out: Annotated[str, means("folder for lights (.jsonl) and pictures (EXR and PNG); empty: nothing is written"), PATH] = ""
    wire: Wire = Wire()
    capture: Capture = Capture()
    rig: Rig = Rig()
    sampler: Sampler = Sampler()
    renderer: Renderer = Renderer()
    viewer: Viewer = Viewer()
    plate: Plate = Plate()
    fixtures: Fixtures = Fixtures()

    @property
    def services(self) -> tuple[Service, ...]:
        """Those that run."""
        optional = {"plate": self.plate.source, "fixtures": self.fixtures.rig, "fuse": self.rig.file}
        return tuple(service for service in SERVICES if optional.get(service, True))
