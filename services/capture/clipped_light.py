"""What clipped light must have had, by a light meter beside the camera: an estimate, and named as one.

A clipped pixel is a lower bound. A meter that lies level and looks up reads the illuminance of all light above the horizon; what the map
lacks of its reading is given to the clipped pixels, in proportion to what they hold. So all lights that are clipped are brighter by one
factor, and keep the places and colours that their pixels have.
"""

import numpy as np

from vemlight.capture.ground import horizontal_irradiance
from vemlight.files import notice
from vemlight.light.bright_cells import BrightCells
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.sphere import Coverage

# Of the map's illuminance: less is what response, lens and meter err by, and no clipped light. Meters of class B may err by 10 %, those
# of class A by 5 (DIN 5032-7).
LEAST_MISSING = 0.1


def gain_by_meter(meter_lux: float, seen_lux: float, clipped_lux: float) -> float:
    """By how many times its own light the clipped light is to be increased; 0, with a notice, where the meter does not tell.

    seen_lux: illuminance that the map gives to a level surface. clipped_lux: the part of it that is from clipped pixels.
    """
    if meter_lux < (1 + LEAST_MISSING) * seen_lux:
        fault = f"meter_lux = {meter_lux:g} is not more than the map's own light by {100 * LEAST_MISSING:g} %"
    elif clipped_lux <= 0:
        fault = "it is below the horizon, where no meter that looks up sees it"
    else:
        notice(f"clipped light is estimated by meter_lux = {meter_lux:g}; estimated_lux says how much of it was not seen")
        return (meter_lux - seen_lux) / clipped_lux
    notice(f"light is clipped, and {fault}: it stays a lower bound")
    return 0.0


def level_lux(radiance: np.ndarray, coverage: Coverage, bright_cells: BrightCells, luminance_scale: float) -> float:
    """Illuminance of a level surface that faces up under a polar map of so many cd/m2 per unit, lux."""
    return luminance_scale * float(luminance_from_rgb(horizontal_irradiance(radiance, bright_cells, coverage)))


def with_bright_top(table: np.ndarray, top: int, gain: float) -> np.ndarray:
    """A table of radiance by code in which the clipped ones, from `top` on, have so many times their radiance in addition."""
    if not gain:
        return table
    brighter = table.copy()
    brighter[top:] *= 1 + gain
    return brighter
