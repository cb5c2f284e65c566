"""The options of the commands that light and render files, as records: the command line builds them, offline.py reads them.

None stands for an option that was left out. Imports nothing heavy, so that `vemlight --help` answers at once; values are checked
where they become settings.
"""

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TypeVar

import msgspec

Options = TypeVar("Options", bound=msgspec.Struct)


class SamplingOptions(msgspec.Struct, frozen=True, kw_only=True):
    """A source and how to sample it: what `lights` and `render` have in common."""

    source: Path
    count: int = 72
    method: str | None = None
    coverage: str = "hemisphere"
    filter: str | None = None  # None: the method's own for sequences, none for a single map
    deflicker: bool = False
    fps: float | None = None
    lens: Path | None = None
    response: Path | None = None
    layer: str | None = None


class LightsOptions(SamplingOptions, frozen=True, kw_only=True):
    """The options of `vemlight lights`."""

    out: Path
    clusters: int | None = None
    error_percent: float | None = None
    score: bool = False


class RenderOptions(SamplingOptions, frozen=True, kw_only=True):
    """The options of `vemlight render`."""

    out: Path | None = None
    video: Path | None = None
    scene: Path | None = None
    size: tuple[int, int] = (640, 480)  # width, height in pixels
    exposure: float = 0.0  # stops
    tone: str | None = None
    background: str | None = None
    gloss_lights: int | None = None
    shadow_map: int | None = None  # texels on a side


def options_as(kind: type[Options]) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Hands a click command its parameters as one record of `kind`, whose fields have the parameters' names."""

    def decorate(command: Callable[[Options], None]) -> Callable[..., None]:
        @wraps(command)
        def with_record(**values: object) -> None:
            command(kind(**values))

        return with_record

    return decorate
