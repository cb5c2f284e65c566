"""All formats."""

from tests.support.hostile import images, meshes, tables
from tests.support.hostile.format import Format

FORMATS: dict[str, Format] = {**images.FORMATS, **meshes.FORMATS, **tables.FORMATS}
