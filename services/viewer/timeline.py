"""What the source says of itself, for the page: where it stands, and its thumbnails as one picture."""

from typing import Any

import msgspec
import numpy as np

from vemlight.runtime import wire
from vemlight.viewer.pictures import jpeg


class Timeline:
    """The newest of it. `number` counts the sets of thumbnails: a page that has another one asks for the picture again."""

    def __init__(self) -> None:
        self.number = 0
        self.header: wire.SourceMessage | None = None  # None before the first message
        self._positions: list[int] = []
        self._discs = np.empty((0, wire.THUMBNAIL_SIDE, wire.THUMBNAIL_SIDE, 3), np.uint8)
        self._encoded, self._jpeg = 0, b""

    def take(self, header: wire.SourceMessage, arrays: tuple[np.ndarray, ...]) -> None:
        """Takes a message; one without thumbnails leaves those that are there, if they are of the same source."""
        before = self.header
        if before and (before.name, before.frames) != (header.name, header.frames):
            self._replace([], self._discs[:0])
        positions, discs = arrays
        if header.thumbnails and (positions.tolist() != self._positions or not np.array_equal(discs, self._discs)):
            self._replace(positions.tolist(), discs)
        self.header = header

    def _replace(self, positions: list[int], discs: np.ndarray) -> None:
        self._positions, self._discs = positions, discs
        self.number += 1

    @property
    def choices(self) -> tuple[str | None, ...]:
        """What plays and what is being opened."""
        return (self.header.choice, self.header.opening) if self.header else ()

    def summary(self) -> dict[str, Any] | None:
        """For the page; None before the first message. thumbnails: which frames the picture shows, from left to right."""
        if self.header is None:
            return None
        said = msgspec.structs.asdict(self.header)
        del said["version"]
        return said | {"thumbnails": self._positions, "thumbnails_number": self.number}

    def thumbnails_jpeg(self) -> bytes:
        """The thumbnails side by side; empty where there are none."""
        if self._encoded != self.number:
            self._encoded = self.number
            self._jpeg = jpeg(np.concatenate(list(self._discs), 1)[..., ::-1]) if len(self._discs) else b""
        return self._jpeg
