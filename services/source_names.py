"""What a source's name says of it: files, a camera of the kernel or of GenICam, or a stream of the network."""

import re

STREAMS = ("http://", "https://", "rtsp://", "rtsps://", "rtmp://", "rtmps://", "udp://", "tcp://", "rtp://")
GENICAM = "genicam:"  # followed by a camera's serial number, id or name, or `first`


def is_camera(source: str) -> bool:
    """Whether a source is a camera of the kernel or of GenICam, whose frames come as they are taken, and not files, which are replayed.

    /dev/videoN and the lasting names under /dev/v4l are cameras; /dev/shm is a folder in memory.
    """
    return is_genicam(source) or (source.startswith("/dev/") and not source.startswith("/dev/shm/"))


def is_genicam(source: str) -> bool:
    """Whether a source is a camera that is found through its maker's GenTL producer, and has no path."""
    return source.startswith(GENICAM)


def is_stream(source: str) -> bool:
    """Whether a source is the address of a stream of a network, whose frames come as they are sent."""
    return source.lower().startswith(STREAMS)


def is_path(source: str) -> bool:
    """Whether a source is a file, a folder or a device, which is looked for from a folder on."""
    return not (is_genicam(source) or is_stream(source))


def is_live(source: str) -> bool:
    """Whether frames come by themselves, once, and are not replayed."""
    return is_camera(source) or is_stream(source)


def shown_source(source: str) -> str:
    """A source as it may be printed: an address without its user and password, and without what follows a question mark."""
    if not is_stream(source):
        return source
    scheme, _, rest = source.partition("://")
    host, slash, path = re.split("[?#]", rest, maxsplit=1)[0].partition("/")
    return f"{scheme}://{host.rpartition('@')[2]}{slash}{path}"
