"""What services report of their own work, in the headers of their frames and in their statuses."""

from typing import Annotated

import msgspec
from msgspec import Meta

from vemlight.runtime.wire_fields import Count, Frames, Hertz, Lux, Milliseconds

LOSS = Meta(extra={"is_loss": True})  # a value of a report that counts losses


class Report(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"):
    """What a service measured while it made a frame. Travels in the frame's header and again in the service's status.

    The status, the viewer's page and `/metrics` show every field of the classes below without changes elsewhere: by its name, whose last
    word is the unit, by its description, and coloured when one that is marked LOSS grows.
    """


class MapReport(Report, frozen=True, tag="map"):
    """Measured while a map was made."""

    invalid_cells: Annotated[Count, LOSS, Meta(description="cells of the newest map that were nan, infinite or negative, set to 0")] = 0
    black_pixels: Annotated[Count, Meta(description="pixels of the newest frame that the sensor clipped at its lower end")] = 0
    saturated_pixels: Annotated[Count, LOSS, Meta(description="pixels clipped at the upper end: their radiance is unknown")] = 0
    estimated_lux: Annotated[
        Lux,
        Meta(title="estimated light", description="on a level surface, that clipped pixels do not show and a light meter tells; 0: none"),
    ] = 0.0
    masked_cells: Annotated[Count, Meta(description="cells of the newest map that masks leave out or fill, wholly or in part")] = 0


class LightsReport(Report, frozen=True, tag="lights"):
    """Measured while lights were sampled and filtered."""

    delay_ms: Annotated[Milliseconds, Meta(title="filter delay", description="by how much the temporal filter delays the lights")] = 0.0
    delay_frames: Annotated[Frames, Meta(title="delay in frames", description="of the filter, at the rate at which frames arrive")] = 0.0
    required_lights: Annotated[Count, Meta(description="lights that the scene requires for the error allowed; 0: not estimated")] = 0
    light_budget: Annotated[Count, Meta(description="lights that the renderer can draw in its target frame time; 0: no limit")] = 0
    error_ratio: Annotated[
        float, Meta(ge=0, le=1e9, title="error", description="of these lights at hard edges, estimated, relative; 0: no limit is set")
    ] = 0.0
    error_limit_ratio: Annotated[float, Meta(ge=0, le=1, title="error limit", description="that the number of lights keeps; 0: none")] = 0.0
    flicker_hz: Annotated[Hertz, Meta(title="flicker beat", description="beat of the lamps' flicker with the frame rate; 0: none")] = 0.0
    lamp_hz: Annotated[Hertz, Meta(title="lamp frequency", description="at which the lamps themselves flicker; 0: no flicker")] = 0.0
    flicker_depth: Annotated[float, Meta(ge=0, le=1e9, description="amplitude of the flicker over its mean")] = 0.0


class ImageReport(Report, frozen=True, tag="image"):
    """Measured while a picture was drawn."""

    drawn_lights: Annotated[Count, Meta(description="lights in the newest picture")] = 0
    render_ms: Annotated[Milliseconds, Meta(title="render time", description="time to draw the newest picture")] = 0.0
    light_budget: Annotated[
        Count, Meta(description="lights that can be drawn in the target frame time; 0: no target, or not yet known")
    ] = 0
    near_lights: Annotated[Count, Meta(title="near lights", description="near lights that shine in the newest picture's frame")] = 0
    left_out_near_lights: Annotated[
        Count, Meta(title="left out", description="of them, those for which there is no time: the nearest drawn shine for them")
    ] = 0
    passes: Annotated[Count, Meta(description="of a paused picture, whose mean is shown; 0: not paused")] = 0
    max_passes: Annotated[Count, Meta(title="passes in all", description="after which a paused picture is done; 0: not paused")] = 0
    pass_error_ratio: Annotated[
        float, Meta(ge=0, le=1e9, title="error of passes", description="of a paused picture, estimated, relative; 0: not known")
    ] = 0.0
    bounces_left_out: Annotated[Count, Meta(description="of light from surface to surface, since time is short")] = 0
    map_halvings: Annotated[Count, Meta(description="how many times the sides of all shadow maps are halved, since time is short")] = 0


class LevelsReport(Report, frozen=True, tag="levels"):
    """Measured while the levels of fixtures were solved and sent."""

    armed: Annotated[int, Meta(ge=0, le=1, description="1: packets are live; 0: a preview, which no fixture shows")] = 0
    blackout: Annotated[int, Meta(ge=0, le=1, description="1: darkness is sent")] = 0
    unmatched_ratio: Annotated[
        float, Meta(ge=0, le=1e9, title="unmatched", description="of the light at the target, that the rig does not give, relative")
    ] = 0.0
    limited_fixtures: Annotated[Count, Meta(title="at full", description="fixtures at full that should give more")] = 0
    off_gamut_fixtures: Annotated[Count, Meta(title="off gamut", description="fixtures that cannot mix the colour asked for")] = 0
    solve_ms: Annotated[Milliseconds, Meta(title="solve time", description="time to solve the newest levels")] = 0.0
    delay_ms: Annotated[Milliseconds, Meta(title="delay", description="of smoothing and of packets between two frames")] = 0.0
    held_ms: Annotated[Milliseconds, Meta(title="look held for", description="time since the last lights came")] = 0.0
    packets: Annotated[Count, Meta(description="sent since the start")] = 0


class PointsReport(Report, frozen=True, tag="points"):
    """Measured while the maps of several cameras became one."""

    cameras: Annotated[Count, Meta(description="whose maps are in the newest frame")] = 0
    silent_cameras: Annotated[Count, Meta(description="of the rig, that are left out because nothing comes, or nothing but black")] = 0
    sources: Annotated[Count, Meta(description="compact sources of light, in all maps")] = 0
    near_lights: Annotated[Count, Meta(description="located and tracked")] = 0
    hidden_lights: Annotated[Count, Meta(description="of them, those not seen well enough in the newest frame")] = 0
    unexplained_sources: Annotated[
        Count, Meta(description="sources that two cameras should see and no place explains: a pose may be wrong")
    ] = 0
    uncovered_ratio: Annotated[float, Meta(ge=0, le=1, title="uncovered", description="fraction of the map that no camera sees")] = 0.0
    spread_ms: Annotated[
        Milliseconds, Meta(title="spread in time", description="between the earliest and the latest map of the newest frame")
    ] = 0.0


AnyReport = MapReport | LightsReport | ImageReport | LevelsReport | PointsReport
