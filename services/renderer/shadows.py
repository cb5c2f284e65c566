"""Which kind of shadows a machine draws: by rays on the processor, or by maps on the GPU."""

from typing import Literal

from vemlight.choices import Shadows
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.renderer.rays.embree import library


def shadows_of(wanted: Shadows, shadow_map: int | None, on_processor: bool, embree: bool) -> Literal["rays", "maps"] | None:
    """Rays where pictures are drawn on the processor, maps where a GPU draws or a resolution of maps is asked for.

    embree: whether it is installed. None: it is not, and there should be rays.
    """
    if wanted == "maps" or (wanted == "auto" and (shadow_map is not None or not on_processor)):
        return "maps"
    return "rays" if embree else None


def chosen_shadows(wanted: Shadows, shadow_map: int | None, on_processor: bool) -> Literal["rays", "maps"]:
    """As `shadows_of`, or else maps with a notice. Raises UserError where rays are wanted and Embree is not installed."""
    if kind := shadows_of(wanted, shadow_map, on_processor, library() is not None):
        return kind
    if wanted == "rays":
        raise UserError('[renderer] shadows: "rays" takes the package embreex, which is not installed; install it, or choose "maps"')
    notice('[renderer] shadows: drawn by maps, since embreex is not installed; with it thin things, slits and corners are exact')
    return "maps"
