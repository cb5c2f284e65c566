"""The wire protocol: encodes and decodes every message between services.

A message is (topic, header, array, ...): the header is a msgpack map, an array is raw little-endian numbers whose type the message's kind
fixes. `unpack` returns typed, finite data of known shape or raises ValueError. proto/ describes the protocol in words, with the exported
schema and golden messages.
"""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, NamedTuple, Union

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.light.light_set import are_covariances
from vemlight.light.mask import MAX_MASKS, Mask, check_masks
from vemlight.light.near_lights import MAX_NEAR_LIGHTS, NearLightSet
from vemlight.light.sphere import Coverage
from vemlight.light.virtual_lamp import MAX_LAMPS, VirtualLamp, check_lamps
from vemlight.runtime.poses import MAX_POSES, Pose, View
from vemlight.runtime.reports import AnyReport, ImageReport, LevelsReport, LightsReport, MapReport, PointsReport
from vemlight.runtime.stamps import Stamp
from vemlight.runtime.wire_fields import (
    ChoiceName,
    Count,
    Finite,
    Hertz,
    Lux,
    Metres,
    Milliseconds,
    Name,
    Sequence53,
    Side,
    SourceSeconds,
)

VERSION = 2  # of the protocol; a message without one is of version 1, which had none
MAX_HEADER = 64 * 1024  # bytes; the longest legal header has 60 kB, most have under 2 kB
MAX_PART = 64 * 1024 * 1024  # bytes: a 4096 x 4096 RGBA picture, or a 1365 x 4096 map
# Upper bounds of the histogram of a service's times for one frame: three a decade, from a fast capture to a picture of many samples.
STEP_BOUNDS_MS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)
STEP_BINS = len(STEP_BOUNDS_MS) + 1  # the last: longer than the last bound
UNIT = 1e-3  # by which a unit vector's squared length may be off: three decimals of each number are enough
MAX_FIXTURES = 512  # of a rig: with names of 24 four-byte letters 51 kB of header

MAX_CHOICES = 64  # of sources: with names of 64 four-byte letters 41 kB of header
MAX_THUMBNAILS, THUMBNAIL_SIDE = 48, 48  # 332 kB in all; a page of 1,920 pixels has room for 40


class Array(NamedTuple):
    """An array of a message."""

    name: str
    dtype: Literal["<f2", "<f4", "<i8", "|u1"]
    shape: tuple[str | int, ...]  # numbers, and names of the header's fields that hold them
    meaning: str
    only_if: str = ""  # name of the header's field that says whether the array is there; empty: always


class Header(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """The header of a message. Each subclass is a kind of message: its tag is the topic, ARRAYS what follows."""

    ARRAYS: ClassVar[tuple[Array, ...]] = ()
    version: Literal[2] = VERSION

    @property
    def kind(self) -> str:
        return str(self.__struct_config__.tag)

    def layout(self) -> list[tuple[str, tuple[int, ...]]]:
        """Type and shape of each array that belongs to this header."""
        arrays = (array for array in self.ARRAYS if not array.only_if or getattr(self, array.only_if))
        return [(array.dtype, tuple(n if isinstance(n, int) else getattr(self, n) for n in array.shape)) for array in arrays]

    def check(self, arrays: Sequence[np.ndarray]) -> None:
        """Raises ValueError for arrays of the right type and shape whose values cannot be."""


class FrameHeader(Header, frozen=True):
    """The header of a frame: of a message that belongs to one moment of the source."""

    stamp: Stamp


class MapMessage(FrameHeader, frozen=True, tag="map"):
    """Radiance as a polar map."""

    ARRAYS = (
        Array("radiance", "<f4", ("rows", "cols", 3), "linear Rec. 709"),
        Array("cells", "<i8", ("bright_samples",), "of each sample inside a bright cell: `row * cols + column`, ascending"),
        Array("directions", "<f4", ("bright_samples", 3), "towards the sample's centre of light"),
        Array("weights", "<f4", ("bright_samples",), "the sample's fraction of its cell's light, in (0, 1]"),
    )
    rows: Side
    cols: Side
    coverage: Coverage
    bright_samples: Annotated[int, Meta(ge=0, le=4096)] = 0
    segment: Count = 0  # how often the source has jumped: light of another segment says nothing about this one's
    luminance_scale: Annotated[float, Meta(gt=0, le=1e30)] | None = None  # cd/m2 per unit, when calibrated
    clipped: bool = False  # the sensor clipped light, so that the map holds less than there was, or an estimate
    report: MapReport = MapReport()

    def check(self, arrays: Sequence[np.ndarray]) -> None:
        _, cells, _, weights = arrays
        if not ((cells >= 0) & (cells < self.rows * self.cols)).all():
            raise ValueError("map: a bright cell outside the map")
        if not ((np.diff(cells) >= 0).all() and ((weights > 0) & (weights <= 1)).all()):
            raise ValueError("map: bright cells out of order, or a weight outside (0, 1]")


class LightsMessage(FrameHeader, frozen=True, tag="lights"):
    """Directional lights.

    The gloss set represents the same light as the first set by many weak lights, for the lobes of glossy surfaces (Havran et al. 2005,
    section 4.2).
    """

    ARRAYS = (
        Array("ids", "<i8", ("count",), "the same as long as the light exists"),
        Array("directions", "<f4", ("count", 3), "unit vectors from the scene towards the light"),
        Array("irradiance", "<f4", ("count", 3), "RGB on a plane facing the light, never negative"),
        Array("covariances", "<f4", ("count", 6), "of the directions of a light's light: xx xy xz yy yz zz", only_if="soft"),
        Array("gloss_directions", "<f4", ("gloss_count", 3), "of the gloss set"),
        Array("gloss_irradiance", "<f4", ("gloss_count", 3), "of the gloss set"),
    )
    count: Annotated[int, Meta(ge=0, le=100_000)]
    coverage: Coverage
    soft: bool = False  # the lights of the first set have extents
    gloss_count: Annotated[int, Meta(ge=0, le=100_000)] = 0
    clipped: bool = False  # as the map says
    estimated_lux: Lux = 0.0  # on a level surface, of clipped light that the map's source estimated
    report: LightsReport = LightsReport()

    def check(self, arrays: Sequence[np.ndarray]) -> None:
        for directions, irradiance in (arrays[1:3], arrays[-2:]):
            if not (np.abs(np.einsum("ij,ij->i", directions, directions) - 1) < UNIT).all() or (irradiance < 0).any():
                raise ValueError("lights: a direction that is not a unit vector, or negative irradiance")
        if self.soft and not are_covariances(arrays[3]):
            raise ValueError("lights: a covariance that no light can have")


class PointsMessage(FrameHeader, frozen=True, tag="points"):
    """Near lights, which the map of the same stamp is without."""

    ARRAYS = (
        Array("ids", "<i8", ("count",), "the same as long as the light exists"),
        Array("at", "<f4", ("count", 3), "the light's place, metres, world, each within 10^6"),
        Array("intensity", "<f4", ("count", 3), "RGB, W/sr: irradiance times squared distance, 0 to 10^30"),
        Array("radius", "<f4", ("count",), "metres, of a sphere of equal second moment, 0 to 10^6"),
        Array("sigma", "<f4", ("count",), "metres, of the place: square root of the trace of its covariance, 0 to 10^6"),
    )
    count: Annotated[int, Meta(ge=0, le=MAX_NEAR_LIGHTS)]
    at: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)  # the place that the map and directional lights of this stamp are true for
    report: PointsReport = PointsReport()

    def check(self, arrays: Sequence[np.ndarray]) -> None:
        if fault := NearLightSet(*arrays).fault():
            raise ValueError(f"points: near lights {fault}")


class ImageMessage(FrameHeader, frozen=True, tag="image"):
    """A rendered picture."""

    ARRAYS = (
        Array("pixels", "|u1", ("height", "width", 4), "sRGB, straight alpha, top row first"),
        Array("linear_pixels", "<f2", ("height", "width", 4), "before tone mapping, premultiplied alpha", only_if="linear"),
    )
    width: Side
    height: Side
    linear: bool = False
    objects: Annotated[tuple[Pose, ...], Meta(max_length=MAX_POSES)] = ()  # where the scene's objects and lamps stand in it
    # Of the curve that made `pixels`: from luminance to L, and the L that becomes white; 0: 1 - exp(-L). None: not tone-mapped.
    tone_scale: Annotated[float, Meta(ge=0, le=1e30)] | None = None
    tone_white: Annotated[float, Meta(ge=0, le=1e30)] = 0.0
    report: ImageReport = ImageReport()


class SceneMessage(Header, frozen=True, tag="scene"):
    """The scene as browsers draw it, see vemlight.runtime.flat_scene; without arrays, and with the reason, where it is too large."""

    ARRAYS = (
        Array("description", "|u1", ("description_bytes",), "JSON, a FlatScene"),
        Array("data", "|u1", ("data_bytes",), "the arrays and textures that it describes"),
    )
    description_bytes: Annotated[int, Meta(ge=0, le=2**22)]
    data_bytes: Annotated[int, Meta(ge=0, le=48 * 2**20)]
    text: Annotated[str, Meta(max_length=512)] = ""  # why there is none


class PlateMessage(FrameHeader, frozen=True, tag="plate"):
    """A second camera's picture."""

    ARRAYS = (Array("pixels", "|u1", ("height", "width", 3), "sRGB, top row first"),)
    width: Side
    height: Side


class LevelsMessage(FrameHeader, frozen=True, tag="levels"):
    """Levels of real fixtures, with the rig as it stands, so that a program can draw it without the rig's file."""

    ARRAYS = (
        Array("positions", "<f4", ("count", 3), "of the fixtures, metres"),
        Array("aims", "<f4", ("count", 3), "a place on the fixture's axis, metres"),
        Array("emitters", "<i8", ("count",), "how many of the levels are each fixture's, 1 or more"),
        Array("levels", "<f4", ("level_count",), "of each emitter, 0 to 1: the fraction of its light at full"),
        Array("light", "<f4", ("count", 3), "what each fixture gives, RGB, over its luminance at full; negative outside Rec. 709"),
        Array("marks", "|u1", ("count",), "1: at full and should give more; 2: cannot mix the colour; 3: both"),
    )
    count: Annotated[int, Meta(ge=1, le=MAX_FIXTURES)]
    level_count: Annotated[int, Meta(ge=1, le=2048)]
    names: Annotated[tuple[Annotated[str, Meta(min_length=1, max_length=24)], ...], Meta(max_length=MAX_FIXTURES)]
    target: tuple[Metres, Metres, Metres]
    unmatched_rgb: tuple[Finite, Finite, Finite]  # RMS of what is missing over all normals, over that of the whole target
    unmatched_at: tuple[Finite, Finite, Finite]  # unit normal of the plane that misses most luminance
    missing_there: Finite  # as a fraction of what the light gives it; negative: too much
    text: Annotated[str, Meta(max_length=1024)]  # what is not matched, in words
    report: LevelsReport = LevelsReport()

    def check(self, arrays: Sequence[np.ndarray]) -> None:
        _, _, emitters, levels, _, marks = arrays
        if len(self.names) != self.count or (emitters < 1).any() or emitters.sum() != self.level_count:
            raise ValueError("levels: names or numbers of emitters that do not fit the rig")
        if not ((levels >= 0) & (levels <= 1)).all() or (marks > 3).any():
            raise ValueError("levels: a level outside 0 to 1, or an unknown mark")


class ControlMessage(Header, frozen=True, tag="control"):
    """What the person at the viewer has chosen; what is left out stays as the settings say."""

    count: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    exposure: Annotated[float, Meta(ge=-20, le=20)] | None = None  # stops
    filtered: bool | None = None
    paused: bool = False
    armed: bool | None = None  # fixtures: packets are live; None: as it is
    blackout: bool | None = None  # fixtures: darkness is sent; None: as it is
    speed: Annotated[float, Meta(ge=0.25, le=4)] | None = None  # files: of playing, as a multiple of the settings'
    loop: bool | None = None  # files: from the first frame again after the last; None: yes
    in_s: SourceSeconds | None = None  # files: the range that is played, where frame n is at n / fps; None: to the end
    out_s: SourceSeconds | None = None
    seek_number: Count | None = None  # files: a new number is a new wish to go to `seek_s`; the same again is none
    seek_s: SourceSeconds = 0.0
    source: ChoiceName | None = None  # one of `SourceMessage.choices`, or "upload ID"; None: the settings'
    scene: Annotated[str, Meta(pattern="^[0-9a-f]{16}$")] | None = None  # the number of an upload; None: the settings'
    record: bool = False  # cameras: their frames are written to a folder of their own
    poses: Annotated[tuple[Pose, ...], Meta(max_length=MAX_POSES)] = ()  # of the objects moved from where scene file or settings have them
    camera: View | None = None  # None: the scene file's
    masks: Annotated[tuple[Mask, ...], Meta(max_length=MAX_MASKS)] | None = None  # instead of the settings'
    lamps: Annotated[tuple[VirtualLamp, ...], Meta(max_length=MAX_LAMPS)] | None = None  # virtual ones, instead of the settings'

    def __post_init__(self) -> None:
        check_masks(self.masks or ())
        check_lamps(self.lamps or ())
        if self.in_s is not None and self.out_s is not None and self.in_s > self.out_s:
            raise ValueError("in_s is after out_s")


class SourceChoice(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A source that may be chosen."""

    choice: ChoiceName
    label: Annotated[str, Meta(max_length=64)]


class SourceMessage(Header, frozen=True, tag="source"):
    """What the source is, where it stands, and some of its frames as small discs: the sky from below, as on the page."""

    ARRAYS = (
        Array("positions", "<i8", ("thumbnails",), "which frames of the source the discs show, ascending"),
        Array("discs", "|u1", ("thumbnails", THUMBNAIL_SIDE, THUMBNAIL_SIDE, 3), "sRGB"),
    )
    name: Annotated[str, Meta(max_length=256)]
    frames: Count  # 0: a camera or stream
    fps: Hertz
    position: Count = 0  # the frame that was published last
    at_end: bool = False  # it stands, because nothing follows it
    thumbnails: Annotated[int, Meta(ge=0, le=MAX_THUMBNAILS)] = 0  # of this message, which has them now and then
    choice: ChoiceName | None = None  # what plays; None: the settings' source
    choices: Annotated[tuple[SourceChoice, ...], Meta(max_length=MAX_CHOICES)] = ()
    opening: ChoiceName | None = None  # what is being opened while this one plays
    refusal: Annotated[str, Meta(max_length=512)] = ""  # why the last choice does not play, or a recording has ended
    recording: Annotated[str, Meta(max_length=256)] = ""  # name of the folder; empty: nothing is recorded
    recorded_frames: Count = 0
    recorded_bytes: Count = 0
    record_bytes_s: Annotated[float, Meta(ge=0, le=1e15)] = 0.0  # bytes a second that the recording takes, lately
    free_bytes: Count = 0  # of the disk that recordings go to
    why_not_record: Annotated[str, Meta(max_length=256)] = ""
    recent_s: Annotated[float, Meta(ge=0, le=1e6)] = 0.0  # how far the frames that are kept in memory reach back
    recent_bytes: Count = 0  # what they take

    def check(self, arrays: Sequence[np.ndarray]) -> None:
        if ((arrays[0] < 0) | (arrays[0] >= max(self.frames, 1))).any() or (np.diff(arrays[0]) <= 0).any():
            raise ValueError("source: discs of frames that there are not, or out of order")


class StatusMessage(Header, frozen=True, tag="status"):
    """How a service is doing."""

    service: Name
    sequence: Sequence53 | None  # of its newest frame
    rate_hz: Hertz
    age_ms: Milliseconds | None  # of its newest frame when it was done
    step_ms: Milliseconds | None  # time for one frame, median of the last ones
    frames: Count  # done since the service started
    skipped: Count  # received, but passed over for a newer frame because this service was slower than its input
    dropped: Count  # published by the producer, by its own count, and never received here
    refused: Count  # messages that `unpack` refused
    restarts: Count  # how often the supervisor had to restart it
    unwritten: Count = 0  # made, but not written to files because the disk refused
    # How many frames took up to each of STEP_BOUNDS_MS and more than the bound before, then how many took longer; and all their time.
    step_counts: Annotated[tuple[Count, ...], Meta(min_length=STEP_BINS, max_length=STEP_BINS)] = STEP_BINS * (0,)
    step_total_ms: Milliseconds = 0.0
    report: AnyReport | None = None  # of its newest frame


class EndMessage(Header, frozen=True, tag="end"):
    """The stream is over: `sequence` is the number of the first frame that will not come."""

    sequence: Sequence53


class RequestMessage(Header, frozen=True, tag="request"):
    """Lossless mode, from a consumer: send the `count` frames from `first` on. Replaces what was requested before."""

    first: Sequence53
    count: Annotated[int, Meta(ge=1, le=1024)]


def _kinds(header: type[Header]) -> list[type[Header]]:
    subclasses = header.__subclasses__()
    return [kind for subclass in subclasses for kind in _kinds(subclass)] if subclasses else [header]


KINDS: dict[str, type[Header]] = {str(kind.__struct_config__.tag): kind for kind in _kinds(Header)}
MAX_PARTS = 2 + max(len(kind.ARRAYS) for kind in KINDS.values())  # topic, header, arrays
AnyHeader = Union[tuple(KINDS.values())]  # noqa: UP007, of a table
Message = tuple[Header, tuple[np.ndarray, ...]]

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(AnyHeader)


class _Version(msgspec.Struct):
    """A header of any version: the one key that this version of the protocol needs before it can read the others."""

    version: int = 1


_version_decoder = msgspec.msgpack.Decoder(_Version)


class VersionError(ValueError):
    """A message of another version of the protocol."""


def pack(header: Header, arrays: Sequence[np.ndarray] = ()) -> list[bytes]:
    """The message's parts. Raises ValueError when the arrays are not those of the header."""
    expected = header.layout()
    if len(arrays) != len(expected):
        raise ValueError(f"{header.kind}: {len(expected)} arrays belong to it, not {len(arrays)}")
    parts = [header.kind.encode(), _encoder.encode(header)]
    for array, (dtype, shape) in zip(arrays, expected, strict=True):
        if array.shape != shape:
            raise ValueError(f"{header.kind}: array of shape {array.shape}, the header says {shape}")
        parts.append(np.ascontiguousarray(array, dtype).tobytes())
    return parts


def unpack(parts: Sequence[bytes]) -> Message:
    """Header and arrays (read-only views of the parts). Raises ValueError for anything that `pack` would not have made, its subclass
    VersionError for a message of another version.
    """
    if not 2 <= len(parts) <= MAX_PARTS:
        raise ValueError(f"a message has 2 to {MAX_PARTS} parts, not {len(parts)}")
    if len(parts[1]) > MAX_HEADER:
        raise ValueError(f"a header has at most {MAX_HEADER} bytes, not {len(parts[1])}")
    header = _header(parts[1])
    if bytes(parts[0]) != header.kind.encode():
        raise ValueError(f"topic {bytes(parts[0][:20])!r} on a message of kind {header.kind}")

    expected = header.layout()
    if len(parts) != 2 + len(expected):
        raise ValueError(f"{header.kind}: {len(expected)} arrays belong to it, not {len(parts) - 2}")
    arrays = []
    for part, (dtype, shape) in zip(parts[2:], expected, strict=True):
        nbytes = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
        if len(part) != nbytes or nbytes > MAX_PART:
            raise ValueError(f"{header.kind}: array of {len(part)} bytes, the header says {nbytes}, the limit is {MAX_PART}")
        array = np.frombuffer(part, dtype).reshape(shape)
        if dtype in ("<f2", "<f4") and not np.isfinite(array).all():
            raise ValueError(f"{header.kind}: array with nan or inf")
        arrays.append(array)
    header.check(arrays)
    return header, tuple(arrays)


def _header(part: bytes) -> Header:
    try:
        version = _version_decoder.decode(part).version
        if version != VERSION:
            raise VersionError(f"message of wire version {version}; this is version {VERSION}: install the same vemlight on both sides")
        return _decoder.decode(part)
    except (RecursionError, OverflowError, MemoryError) as error:  # arrays nested a thousand deep, numbers beyond 64 bits
        raise ValueError(f"a header that cannot be decoded: {error}") from error
