"""Values that settings and options of the command line choose from. Nothing is imported, so that `vemlight --help` answers at once."""

from typing import Literal

Mode = Literal["live", "lossless"]
Tone = Literal["reinhard", "exponential"]
Background = Literal["clear", "map"]
Shadows = Literal["auto", "rays", "maps"]
Method = Literal["tracked", "havran-azimuth", "havran-radius", "standard"]
Filter = Literal["auto", "adaptive", "fir2005", "fir", "binomial", "iir", "none"]
