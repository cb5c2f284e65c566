"""One table of the channels between the services, and which service takes whose frames.

Read by the sockets (topics and queues), by the judgement of liveness and the health check, by the viewer's page and by the tests.
What a message of each kind contains is declared in wire.py.
"""

from typing import Literal, NamedTuple, cast

Service = Literal["capture", "sampler", "renderer", "viewer", "plate", "fixtures", "fuse"]
SERVICES: tuple[Service, ...] = ("capture", "sampler", "renderer", "viewer", "plate", "fixtures", "fuse")  # the order fixes the tcp ports
# What a socket belongs to: a service, "capture", or one of several of its kind, "capture.left".
Instance = str
INSTANCE = rf"^({'|'.join(SERVICES)})(\.[a-z0-9-]{{1,32}})?$"

REPORT_PERIOD_S = 0.5  # a person sees a change within it, and ten messages a second in all cost nothing
QUEUE_FRAMES = 4  # 4 maps are 1.6 MB; with libzmq's own 1000 a stalled reader costs the sender 372 MB


class Channel(NamedTuple):
    """What one service publishes."""

    kind: str  # the messages' topic and the tag of their header in wire.py
    producers: tuple[Service, ...]  # empty: every service
    rate_hz: float | None  # messages a second; None: the source's frame rate
    max_missed: int  # messages missing in a row before the producer counts as stalled (frames) or silent (statuses)
    queue: int  # messages that wait in a socket at most; what comes after is dropped
    meaning: str

    def timeout_s(self, source_fps: float) -> float:
        """How long after a message the producer counts as stalled or silent when no other follows."""
        return self.max_missed / (self.rate_hz or source_fps)


CHANNELS = (
    Channel("map", ("capture", "fuse"), None, 3, QUEUE_FRAMES, "radiance of one frame as a polar map"),
    Channel("lights", ("sampler",), None, 3, QUEUE_FRAMES, "directional lights of one frame"),
    Channel("points", ("fuse",), None, 3, QUEUE_FRAMES, "near lights of one frame, which its map is without"),
    Channel("scene", ("renderer",), None, 3, 1, "the scene's geometry, materials and textures, to each who subscribes"),
    Channel("image", ("renderer",), None, 3, QUEUE_FRAMES, "the scene lit by one frame's lights, rendered and tone-mapped"),
    Channel("plate", ("plate",), None, 3, QUEUE_FRAMES, "a second camera's picture, shown behind the scene"),
    Channel("levels", ("fixtures",), None, 3, QUEUE_FRAMES, "levels of real fixtures that one frame's lights ask for"),
    Channel("source", ("capture",), 1 / REPORT_PERIOD_S, 3, QUEUE_FRAMES, "what the source is and where it stands, with thumbnails"),
    Channel("control", ("viewer",), 1 / REPORT_PERIOD_S, 3, QUEUE_FRAMES, "everything that the person at the viewer has chosen"),
    Channel("status", (), 1 / REPORT_PERIOD_S, 3, QUEUE_FRAMES, "how a service is doing"),
    Channel("end", (), None, 3, QUEUE_FRAMES, "no frame of this number or a later one will come"),
)
BY_KIND = {channel.kind: channel for channel in CHANNELS}
STATUS = BY_KIND["status"]

# The frames' way: each service, the service whose frames it takes, and of which kind. A later one ends the run when it has the last frame.
# With a rig of cameras `fuse` stands between capture and sampler: services/runtime/instances.py says who is whose upstream in a run.
UPSTREAM: dict[Service, Service | None] = {
    "capture": None, "fuse": "capture", "sampler": "capture", "renderer": "sampler", "plate": None, "fixtures": "sampler"
}  # fmt: skip
TAKES: dict[Service, str] = {"fuse": "map", "sampler": "map", "renderer": "lights", "fixtures": "lights"}
# The frames that a service counts. `fuse` publishes a map beside each.
FRAMES: dict[Service, Channel] = {
    "capture": BY_KIND["map"],
    "fuse": BY_KIND["points"],
    "sampler": BY_KIND["lights"],
    "renderer": BY_KIND["image"],
    "plate": BY_KIND["plate"],
    "fixtures": BY_KIND["levels"],
}
LAST: Service = "renderer"
BACKPRESSURE_FROM: dict[Service, Service] = {"sampler": "renderer"}  # live: of which kind of service it receives the statuses


def service_of(instance: Instance) -> Service:
    """What an instance is one of."""
    name, _, _ = instance.partition(".")
    return cast(Service, name)
