"""Values that settings and options of the command line choose from. Nothing is imported, so that `vemlight --help` answers at once."""

from typing import Literal

Mode = Literal["live", "lossless"]
ExrFloats = Literal["half", "float"]
Tone = Literal["reinhard", "exponential"]
Background = Literal["clear", "map"]
Shadows = Literal["auto", "rays", "maps"]
Method = Literal["tracked", "havran-azimuth", "havran-radius", "standard"]
Filter = Literal["auto", "adaptive", "fir2005", "fir", "binomial", "iir", "none"]
Range = Literal["limited", "full"]
Matrix = Literal["bt601", "bt709", "bt2020", "rgb"]
Primaries = Literal["bt709", "bt2020", "p3d65", "ap0", "ap1", "awg3", "awg4", "sgamut3", "sgamut3cine", "vgamut"]
LightOf = Literal["scene", "display"]
Projection = Literal["equirect", "fisheye", "cube3x2"]
Stereo = Literal["top-bottom", "side-by-side"]
