"""All formats."""

from tests.support.hostile import films, images, meshes, recordings, tables, usd
from tests.support.hostile.format import Format

FORMATS: dict[str, Format] = {**images.FORMATS, **films.FORMATS, **meshes.FORMATS, **usd.FORMATS, **tables.FORMATS, **recordings.FORMATS}
