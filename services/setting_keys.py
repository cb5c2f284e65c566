"""What a key of the settings may hold: ranges, and the unit and meaning that docs/settings.md gives it."""

from typing import Annotated

from msgspec import Meta

from vemlight.runtime.channels import INSTANCE, Instance

# Limits keep a mistyped number from taking all memory. A map of 4096 x 8192 takes 402 MB, a picture of 8192 x 8192 in float32 RGBA
# 1.1 GB, and 100,000 lights are a thousand times what a frame needs; other powers of two would do as well.
MAX_PICTURE_SIDE = 8192
Count = Annotated[int, Meta(ge=1, le=100_000)]
Count0 = Annotated[int, Meta(ge=0, le=100_000)]
Side = Annotated[int, Meta(ge=1, le=MAX_PICTURE_SIDE)]
Rate = Annotated[float, Meta(gt=0, le=1000)]
Frequency = Annotated[float, Meta(gt=0, le=500)]  # up to half of the highest frame rate
ExposureTimes = Annotated[tuple[Annotated[float, Meta(gt=0, le=1e6)], ...], Meta(max_length=8)]
Stops = Annotated[float, Meta(ge=-20, le=20)]  # a factor of a million either way
Port = Annotated[int, Meta(ge=1, le=65_000)]  # the wire takes fourteen ports from its first

InstanceName = Annotated[Instance, Meta(pattern=INSTANCE)]

PATH = Meta(extra={"unit": "path"})
FRAMES = Meta(extra={"unit": "frames"})
FPS = Meta(extra={"unit": "frames/s"})
HZ = Meta(extra={"unit": "Hz"})
MS = Meta(extra={"unit": "ms"})
PER_CENT = Meta(extra={"unit": "%"})
MB = Meta(extra={"unit": "MB"})
CD_M2 = Meta(extra={"unit": "cd/m2"})
LUX = Meta(extra={"unit": "lux"})
PIXELS = Meta(extra={"unit": "pixels"})
STOPS = Meta(extra={"unit": "stops"})
TEXELS = Meta(extra={"unit": "texels"})


def means(text: str) -> Meta:
    """What a key means, for docs/settings.md."""
    return Meta(description=text)
