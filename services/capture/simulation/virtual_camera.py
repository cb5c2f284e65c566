"""The virtual camera: light around in, raw fisheye frames out, with the truth beside them.

A pixel's radiance is the mean over its footprint. Moderate light is gathered, 4 x 4 rays a pixel; what exceeds it (a sun, smaller than a
pixel perhaps) is handed over point by point with its flux, so that nothing bright falls between two rays and none is counted twice.
"""

import json
import math
from pathlib import Path

import numpy as np
from numba import njit

from vemlight.capture.frames import Mosaic
from vemlight.capture.lens import Lens, angle_from_radius, check_lens, pixel_solid_angles, radius_from_angle
from vemlight.capture.response import Response, check_response
from vemlight.capture.simulation.environment import Environment, Maps, Scene, dimmed, disc_points, hemisphere_irradiance, sun_direction
from vemlight.capture.simulation.interior import Interior, mean_cosine
from vemlight.capture.simulation.motion import motion
from vemlight.capture.simulation.sensor import Film, behind_lens, exposed, fixed_pattern
from vemlight.capture.simulation.sky import Sky
from vemlight.errors import UserError

RAYS = 4  # a side of a pixel
BRIGHT = 16.0  # times the image's mean: light above is handed over by flux. Below, a pixel's error is 1/16 of a ray in the worst case
SPREAD = 4  # points a side of a camera's pixel for what is handed over
DISC_POINTS = 4096
FLICKER_DEPTH = 0.3  # of the light's mean: discharge lamps on magnetic ballasts have 0.2 to 0.5
SCENES = {"sky": Sky, "interior": Interior}


def fisheye_radiance(surround: Environment, world_from_map: np.ndarray, lens: Lens) -> np.ndarray:
    """What the lens makes of the light, before vignetting: mean radiance of each pixel (height, width, 3) float64, 0 beyond the rim."""
    solid = pixel_solid_angles(lens)
    map_from_camera = world_from_map.T @ lens.rotation
    level = BRIGHT * surround.image.mean(axis=(0, 1))
    f, c = np.array(lens.f), np.array(lens.c)
    image = np.zeros((*solid.shape, 3))
    if surround.image.any():
        _gather(surround.image, level, image, solid, f, c, lens.k, lens.rim, map_from_camera)
    camera_from_map = np.ascontiguousarray(map_from_camera.T)
    fine = math.ceil(SPREAD * (math.pi / surround.image.shape[0]) * max(lens.f))
    _hand_over_pixels(surround.image, level, fine, image, solid, f, c, lens.k, lens.rim, camera_from_map)
    for disc in surround.discs:
        points, flux = disc_points(disc, DISC_POINTS), disc.irradiance / DISC_POINTS
        _hand_over(points, flux, image, solid, f, c, lens.k, lens.rim, camera_from_map)
    return image


@njit(cache=True)
def _gather(source, level, image, solid, f, c, k, rim, rotation):
    rows, cols, _ = source.shape
    height, width = solid.shape
    for y in range(height):
        for x in range(width):
            if solid[y, x] == 0:
                continue
            for n in range(RAYS * RAYS):
                px = (x - 0.5 + (n % RAYS + 0.5) / RAYS - c[0]) / f[0]
                py = (y - 0.5 + (n // RAYS + 0.5) / RAYS - c[1]) / f[1]
                radius = math.hypot(px, py)
                theta = min(angle_from_radius(radius, k, rim), math.pi)
                across = math.sin(theta) / radius if radius > 0 else 0.0
                dx, dy, dz = px * across, py * across, math.cos(theta)
                mx = rotation[0, 0] * dx + rotation[0, 1] * dy + rotation[0, 2] * dz
                my = rotation[1, 0] * dx + rotation[1, 1] * dy + rotation[1, 2] * dz
                mz = rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz
                row = min(int(math.atan2(math.hypot(mx, my), mz) / math.pi * rows), rows - 1)
                col = int((math.pi - math.atan2(my, mx)) / (2 * math.pi) * cols) % cols
                for q in range(3):
                    image[y, x, q] += min(source[row, col, q], level[q]) / (RAYS * RAYS)


@njit(cache=True)
def _put(dx, dy, dz, flux, image, solid, f, c, k, rim):
    # hands `flux` to the pixel that the camera's direction falls on
    across = math.hypot(dx, dy)
    theta = math.atan2(across, dz)
    if theta > rim * 1.05:
        return
    radius = radius_from_angle(theta, k, rim)
    scale = radius / across if across > 0 else 0.0
    x, y = math.floor(c[0] + f[0] * dx * scale + 0.5), math.floor(c[1] + f[1] * dy * scale + 0.5)
    if 0 <= x < solid.shape[1] and 0 <= y < solid.shape[0] and solid[y, x] > 0:
        for q in range(3):
            image[y, x, q] += flux[q] / solid[y, x]


@njit(cache=True)
def _hand_over(points, flux, image, solid, f, c, k, rim, rotation):
    for n in range(len(points)):
        d = rotation @ points[n]
        _put(d[0], d[1], d[2], flux, image, solid, f, c, k, rim)


@njit(cache=True)
def _hand_over_pixels(source, level, fine, image, solid, f, c, k, rim, rotation):
    rows, cols, _ = source.shape
    flux = np.empty(3)
    for y in range(rows):
        top, bottom = math.cos(y * math.pi / rows), math.cos((y + 1) * math.pi / rows)
        share = (top - bottom) * 2 * math.pi / cols / (fine * fine)
        for x in range(cols):
            over = False
            for q in range(3):
                flux[q] = max(source[y, x, q] - level[q], 0.0) * share
                over |= flux[q] > 0
            if not over:
                continue
            for v in range(fine):
                mz = top + (v + 0.5) / fine * (bottom - top)
                s = math.sqrt(1 - mz * mz)
                for u in range(fine):
                    phi = math.pi - (x + (u + 0.5) / fine) * 2 * math.pi / cols
                    mx, my = s * math.cos(phi), s * math.sin(phi)
                    dx = rotation[0, 0] * mx + rotation[0, 1] * my + rotation[0, 2] * mz
                    dy = rotation[1, 0] * mx + rotation[1, 1] * my + rotation[1, 2] * mz
                    dz = rotation[2, 0] * mx + rotation[2, 1] * my + rotation[2, 2] * mz
                    _put(dx, dy, dz, flux, image, solid, f, c, k, rim)


def open_scene(maps: list[str], seed: int) -> Scene:
    """The procedural scene that the only word of `maps` names, or the lat-long files. Raises UserError when it is neither."""
    if not maps:
        raise UserError(f"no map is named; give lat-long files or one of {', '.join(SCENES)}")
    if len(maps) == 1 and maps[0] in SCENES:
        return SCENES[maps[0]](seed)
    for name in maps:
        if not Path(name).is_file():
            raise UserError(f"{name}: there is no such file, and scenes are {', '.join(SCENES)}; check the path")
    return Maps([Path(name) for name in maps])


def simulate(
    maps: list[str],
    lens: Lens,
    response: Response | None,
    out: Path,
    *,
    frames: int = 0,
    fps: float = 25.0,
    rotate_deg_per_frame: float = 0.0,
    keyframes: Path | None = None,
    noise_codes: float = 0.0,
    pattern_codes: float = 0.0,
    mosaic: Mosaic | None = None,
    exposure_s: float = 0.0,
    flicker_hz: float = 0.0,
    dropouts: float = 0.0,
    truth_maps: bool = False,
    seed: int = 0,
) -> None:
    """Takes `frames` frames (0: one for each map) of the light in `maps` and writes them as NAME_0000.exr .. to `out`, with lens.toml,
    response.toml, manifest.jsonl and truth.jsonl beside them.

    With a response the frames are raw codes (32-bit float EXR, which holds them exactly), after Gaussian noise of `noise_codes` and a
    fixed pattern of `pattern_codes` (sigmas), in three channels or a `mosaic`; without one they are radiance as half floats.
    The maps turn about +Z by `rotate_deg_per_frame`, or as `keyframes` say (TOML: [[key]] time_s, rotate_deg = [x, y, z]).
    `flicker_hz` (100 or 120) makes the light swing with the mains, averaged over `exposure_s`. Of all frames the share `dropouts` is lost,
    as a busy camera loses them: their numbers are missing.

    truth.jsonl has for each frame: irradiance (RGB, integral over the upper hemisphere), sun (unit vector in the world),
    world_from_map (3 x 3), time_s. `truth_maps` adds the folder truth/: the same frames as radiance, without noise.
    Raises UserError for a map, lens, response or keyframe file that cannot be used, OSError when the disk refuses.
    """
    check_lens(lens)
    if response is not None:
        check_response(response)
    scene, turned = open_scene(maps, seed), motion(rotate_deg_per_frame * fps, keyframes)
    count = frames or len(maps)
    kept = np.flatnonzero(np.random.default_rng((seed, 1 << 32)).random(count) >= dropouts)
    film = Film(out, scene.name, lens, response, mosaic, fps, exposure_s)
    true_film = Film(out / "truth", scene.name, lens, None, None, fps, exposure_s) if truth_maps else None
    pattern = fixed_pattern(lens, pattern_codes, seed)
    with open(out / "truth.jsonl", "w", encoding="utf-8") as truth:
        for k in map(int, kept):
            time_s = k / fps
            world_from_map = turned(time_s)
            surround = scene.surround(k, time_s, exposure_s)
            if flicker_hz:
                surround = dimmed(surround, 1 + FLICKER_DEPTH * mean_cosine(flicker_hz, 0.0, time_s, exposure_s))
            radiance = behind_lens(fisheye_radiance(surround, world_from_map, lens), lens)
            film.write(k, time_s, exposed(radiance, response, noise_codes, pattern, mosaic, (seed, k)))
            if true_film:
                true_film.write(k, time_s, radiance.astype(np.float32))
            row = {
                "name": film.name(k),
                "time_s": time_s,
                "irradiance": hemisphere_irradiance(surround, world_from_map).tolist(),
                "sun": (world_from_map @ sun_direction(surround)).tolist(),
                "world_from_map": world_from_map.tolist(),
            }
            truth.write(json.dumps(row) + "\n")
