"""The types of numbers and names in headers, with their limits: what is outside them is refused by whoever decodes."""

from typing import Annotated

from msgspec import Meta

MAX_SIDE = 8192  # pixels of a picture's side
MAX_SEQUENCE = 2**53 - 1  # exact in JSON and in every language, as a float too
Sequence53 = Annotated[int, Meta(ge=0, le=MAX_SEQUENCE)]
Nanoseconds = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Count = Annotated[int, Meta(ge=0, lt=2**53)]
Name = Annotated[str, Meta(min_length=1, max_length=64)]
Finite = Annotated[float, Meta(ge=-1e30, le=1e30)]
Milliseconds = Annotated[float, Meta(ge=0, le=1e14)]  # ages since 1970 fit: 2 x 10^12
Hertz = Annotated[float, Meta(ge=0, le=1e9)]
Lux = Annotated[float, Meta(ge=0, le=1e6)]  # ten times what the sun gives
Frames = Annotated[float, Meta(ge=0, le=1e6)]
ChoiceName = Annotated[str, Meta(min_length=1, max_length=80)]
SourceSeconds = Annotated[float, Meta(ge=0, le=1e7)]  # four months
Side = Annotated[int, Meta(ge=1, le=MAX_SIDE)]
Metres = Annotated[float, Meta(ge=-1e6, le=1e6)]
