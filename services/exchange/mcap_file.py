"""Lights as an MCAP recording, which Foxglove and others open: channel `/lights`, each frame's JSON as it stands in a file of lights."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec

from vemlight.errors import UserError
from vemlight.files import written_whole
from vemlight.light.light_set import LightsRow

TOPIC = "/lights"


class McapRecording:
    """A recording that grows by a frame at a time."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}

    def add(self, schema: str, sequence: int, time_s: float, row_json: bytes) -> None:
        """Adds a frame. schema: `vemlight.lights/1` or `/2`, which is its channel's, too. Raises OSError when the disk refuses."""
        if schema not in self._channels:
            described = msgspec.json.encode(msgspec.json.schema(LightsRow))
            number = self._writer.register_schema(schema, "jsonschema", described)
            self._channels[schema] = self._writer.register_channel(TOPIC, "json", number)
        time_ns = round(time_s * 1e9)
        self._writer.add_message(self._channels[schema], time_ns, row_json, time_ns, sequence % 2**32)


@contextmanager
def mcap_recording(path: Path) -> Iterator[McapRecording]:
    """A recording that has its name once the context ends without an error. Raises UserError without the package mcap."""
    try:
        from mcap.writer import CompressionType, Writer  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise UserError("--mcap: mcap is not installed; pip install 'vemlight[export]'") from error
    with written_whole(path) as part, open(part, "wb") as file:
        opened = Writer(file, compression=CompressionType.NONE)  # LZ4 takes three times as long, for two thirds of the bytes
        opened.start(profile="", library="vemlight")
        yield McapRecording(opened)
        opened.finish()
