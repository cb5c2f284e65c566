"""`vemlight simulate`: the virtual camera's frames of lat-long maps or a procedural scene, with the ground truth beside them."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from vemlight.capture.exposure_cycle import ExposureCycle
from vemlight.capture.exposure_recording import checked_exposures
from vemlight.capture.lens import check_lens
from vemlight.capture.response import check_response
from vemlight.capture.simulation.environment import Environment, LightScene, MapScene, dimmed, hemisphere_irradiance, sun_direction
from vemlight.capture.simulation.exposing import exposures_of_frames
from vemlight.capture.simulation.interior import Interior, mean_cosine
from vemlight.capture.simulation.motion import motion, swaying
from vemlight.capture.simulation.optics import fisheye_radiance
from vemlight.capture.simulation.sensor import SequenceWriter, VirtualCamera, behind_lens, exposed, fixed_pattern, received_frames
from vemlight.capture.simulation.sky import Sky
from vemlight.errors import UserError

FLICKER_DEPTH = 0.3  # of the light's mean: discharge lamps on magnetic ballasts have 0.2 to 0.5
SCENES = {"sky": Sky, "interior": Interior}


class Lighting(msgspec.Struct, frozen=True, kw_only=True):
    """What the virtual camera looks at."""

    maps: tuple[str, ...]  # lat-long files, one a frame, or the name of one of SCENES
    rotate_deg_per_frame: float = 0.0  # of the maps about +Z
    keyframes: Path | None = None  # the maps' rotation instead: TOML of [[key]] time_s, rotate_deg = [x, y, z]
    sway_deg: float = 0.0  # of the camera, at sway_hz
    sway_hz: float = 0.0
    flicker_hz: float = 0.0  # of the light: 100 or 120 with the mains; 0: steady


def open_scene(maps: tuple[str, ...], seed: int) -> LightScene:
    """The procedural scene that the only word of `maps` names, or the lat-long files. Raises UserError when it is neither."""
    if not maps:
        raise UserError(f"no map is named; give lat-long files or one of {', '.join(SCENES)}")
    if len(maps) == 1 and maps[0] in SCENES:
        return SCENES[maps[0]](seed)
    for name in maps:
        if not Path(name).is_file():
            raise UserError(f"{name}: there is no such file, and scenes are {', '.join(SCENES)}; check the path")
    scene = MapScene([Path(name) for name in maps])
    scene.environment(0, 0.0, 0.0)  # so that a map that cannot be read is refused before anything is written
    return scene


def simulate(
    lighting: Lighting, camera: VirtualCamera, out: Path, *, frames: int = 0, truth_maps: bool = False, seed: int = 0
) -> None:
    """Takes `frames` frames (0: one for each map) and writes them as NAME_0000.exr .. to `out`, with lens.toml, response.toml,
    manifest.jsonl and truth.jsonl beside them.

    With a response the frames are raw codes (32-bit float EXR, which holds them exactly), else radiance as half floats. The camera's
    `exposure_s` averages the flicker. truth.jsonl has for each frame: irradiance (RGB, integral over the upper hemisphere),
    level_irradiance (the same times the cosine: of level ground), sun (unit vector in the world), world_from_map (3 x 3), time_s, and of
    several exposures exposure_s. `truth_maps` adds the folder truth/: the same frames as radiance, without noise. Raises UserError for a
    map, lens, response or keyframe file that cannot be used, OSError when the disk refuses.
    """
    check_lens(camera.lens)
    if camera.response is not None:
        check_response(camera.response)
    scene = open_scene(lighting.maps, seed)
    rotation = swaying(motion(lighting.rotate_deg_per_frame * camera.fps, lighting.keyframes), lighting.sway_deg, lighting.sway_hz)
    count = frames or len(lighting.maps)
    received = received_frames(camera, count, seed)
    exposures = _exposures(camera, received, count)
    writer = SequenceWriter(out, scene.name, camera)
    ideal = msgspec.structs.replace(camera, response=None, mosaic=None, exposures=())
    truth_writer = SequenceWriter(out / "truth", scene.name, ideal) if truth_maps else None
    pattern = fixed_pattern(camera, seed)
    with open(out / "truth.jsonl", "w", encoding="utf-8") as truth:
        for k in received:
            time_s = k / camera.fps
            world_from_map = rotation(time_s)
            environment = _flickering(scene.environment(k, time_s, camera.exposure_s), lighting.flicker_hz, time_s, camera.exposure_s)
            radiance = behind_lens(fisheye_radiance(environment, world_from_map, camera.lens), camera.lens)
            writer.write(k, time_s, exposed(radiance, camera, pattern, (seed, k), exposures[k]))
            if truth_writer:
                truth_writer.write(k, time_s, radiance.astype(np.float32))
            row = {"name": writer.name(k), "time_s": time_s, **_ground_truth(environment, world_from_map)}
            truth.write(json.dumps(row | ({"exposure_s": exposures[k]} if camera.exposures else {})) + "\n")
    writer.close(*(path for path in (out / "truth.jsonl", out / "recipe.toml") if path.exists()))
    if truth_writer:
        truth_writer.close()


def _exposures(camera: VirtualCamera, received: list[int], count: int) -> list[float] | list[None]:
    """The exposure of each frame, None for that of the response. Raises UserError for exposures that cannot be taken."""
    if not camera.exposures:
        return [None] * count
    if camera.response is None:
        raise UserError("--exposures: are of raw codes, and frames are radiance without --response; name a response file")
    return exposures_of_frames(ExposureCycle(checked_exposures("--exposures", camera.exposures)), camera.control_delay, received, count)


def _flickering(environment: Environment, flicker_hz: float, time_s: float, exposure_s: float) -> Environment:
    if not flicker_hz:
        return environment
    return dimmed(environment, 1 + FLICKER_DEPTH * mean_cosine(flicker_hz, 0.0, time_s, exposure_s))


def _ground_truth(environment: Environment, world_from_map: np.ndarray) -> dict[str, Any]:
    total, level = hemisphere_irradiance(environment, world_from_map)
    return {
        "irradiance": total.tolist(),
        "level_irradiance": level.tolist(),
        "sun": (world_from_map @ sun_direction(environment)).tolist(),
        "world_from_map": world_from_map.tolist(),
    }
