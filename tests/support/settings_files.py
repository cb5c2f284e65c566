"""Changed settings of tests."""

import msgspec

from vemlight.settings import Settings


def with_section(settings: Settings, section: str, **changes) -> Settings:
    """A copy of the settings with some keys of one section changed."""
    return msgspec.structs.replace(settings, **{section: msgspec.structs.replace(getattr(settings, section), **changes)})
