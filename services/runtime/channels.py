"""One table of the services and of the channels between them. Sockets, liveness, the status page and the tests read it."""

from typing import Literal, NamedTuple

Service = Literal["capture", "sampler", "renderer", "viewer", "plate"]


class Channel(NamedTuple):
    """What one service says. `kind` is the message's topic and the tag of its record."""

    kind: str
    producer: Service | None  # None: every service says it of itself
    meaning: str


CHANNELS = (
    Channel("map", "capture", "radiance of one frame as a polar map"),
    Channel("lights", "sampler", "directional lights of one frame"),
    Channel("image", "renderer", "picture of the scene under one frame's lights, tone-mapped"),
    Channel("plate", "plate", "what a second camera sees, to stand behind the scene"),
    Channel("control", "viewer", "what the person at the viewer wants, whole, twice a second"),
    Channel("status", None, "how a service fares, twice a second"),
    Channel("end", None, "no frame of this number or a later one will come"),
)

# The frames' way: each service and the service whose frames it takes. A later one ends the run when it has the last frame.
UPSTREAM: dict[Service, Service | None] = {"capture": None, "sampler": "capture", "renderer": "sampler", "plate": None}
SERVICES: tuple[Service, ...] = ("capture", "sampler", "renderer", "viewer", "plate")  # the order gives the ports
FRAMES: dict[Service, str] = {channel.producer: channel.kind for channel in CHANNELS if channel.producer in UPSTREAM}
LAST: Service = "renderer"
BACKPRESSURE_FROM: dict[Service, Service] = {"sampler": "renderer"}  # live: whose status a service heeds

STATUS_PERIOD_S = 0.5
SILENT_S = 3 * STATUS_PERIOD_S  # a service unheard for so long is shown as silent: two reports in a row are missing
QUEUE_FRAMES = 4  # high-water mark: 4 maps are 1.6 MB; at libzmq's 1000 a stalled reader costs the sender 372 MB
