"""The camera's transforms, and the sample positions in a pixel."""

from typing import NamedTuple

import numpy as np

from vemlight.renderer.scene.scene import Scene, ViewCamera

# Of far to near, for a camera inside a mesh's box: 24 bits then resolve d^2 / (near 2^24) at a distance d, 6e-5 of it at a hundredth of the
# far plane. With less a camera in a hall of a kilometre would cut what is nearer than a metre. Any value in 30,000 .. 300,000 does.
MAX_DEPTH_RATIO = 100_000
DEPTH_MARGIN = 0.01  # for rounding where surfaces touch the scene's box; any value in 1e-4 .. 0.1 does
MIN_FAR_M = 1e-6  # of a scene that lies behind the camera altogether; any value above 0 does


class PixelSample(NamedTuple):
    """A sample of a pixel: its place in the unit pixel, and its number among the samples, by which hashed alpha shows or hides surfaces."""

    x: float
    y: float
    number: int = 0


def pixel_samples(samples: int) -> list[PixelSample]:
    """Evenly spread samples of a pixel: Hammersley points, shifted by half a step so that a single one lies in the middle."""
    numbers = np.arange(samples)
    places = np.stack([(numbers + 0.5) / samples, (_radical_inverse(numbers) + 0.5 / samples) % 1.0], axis=-1)
    return [PixelSample(x, y, number) for number, (x, y) in enumerate(places.tolist())]


def _radical_inverse(numbers: np.ndarray) -> np.ndarray:
    """Whole numbers (n,) with their binary digits mirrored at the point (van der Corput 1935), float64."""
    mirrored, digit = np.zeros(len(numbers)), 0.5
    while numbers.any():
        mirrored += digit * (numbers % 2)
        numbers, digit = numbers // 2, digit / 2
    return mirrored


def view_from_world(camera: ViewCamera) -> np.ndarray:
    """The rigid transform (4, 4) to axes with x right, y down, z along the view. Looking straight up or down, the world's +Y is on top."""
    forward = np.subtract(camera.at, camera.position)
    forward = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0] if abs(forward[2]) < 1 - 1e-9 else [0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    view = np.eye(4)
    view[:3, :3] = right, np.cross(forward, right), forward
    view[:3, 3] = -view[:3, :3] @ np.array(camera.position)
    return view


def ray_from_pixel(camera: ViewCamera, size: tuple[int, int]) -> np.ndarray:
    """The matrix (3, 3) from (x, y, 1) to the world direction seen there, in a picture of `size` (width, height), row 0 on top.

    Pixel 0 extends from 0 to 1.
    """
    tall = np.tan(np.radians(camera.fov_y) / 2)
    wide = tall * size[0] / size[1]
    view_from_pixel = np.array([[2 * wide / size[0], 0, -wide], [0, 2 * tall / size[1], -tall], [0, 0, 1]])
    return view_from_world(camera)[:3, :3].T @ view_from_pixel


PIXEL_CENTRE = PixelSample(0.5, 0.5)


def nearest_distance(camera: ViewCamera, boxes: np.ndarray) -> float:
    """How far the nearest of boxes (n, 2, 3), lowest and highest corner, is from the camera; 0 inside of one."""
    place = np.array(camera.position, np.float64)
    off = np.maximum(np.maximum(boxes[:, 0] - place, place - boxes[:, 1]), 0)
    return float(np.linalg.norm(off, axis=1).min()) if len(boxes) else 0.0


def clip_from_world(scene: Scene, size: tuple[int, int], sample: PixelSample = PIXEL_CENTRE, nearest_m: float = 0.0) -> np.ndarray:
    """The projection (4, 4) of a picture of `size` (width, height), row 0 first in memory (y down), sampled at `sample` in each pixel.

    The near and far planes enclose the scene's box, and all that is not nearer than nearest_m, with DEPTH_MARGIN; the near one is never
    closer than far / MAX_DEPTH_RATIO.
    """
    view = view_from_world(scene.camera)
    corners = scene.centre + scene.half * np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    depth = corners @ view[2, :3] + view[2, 3]
    far = max(float(depth.max()) * (1 + DEPTH_MARGIN), MIN_FAR_M)
    tall = 1 / np.tan(np.radians(scene.camera.fov_y) / 2)
    wide = tall * size[1] / size[0]
    # What is seen in a corner of the picture at a distance is nearer along the view.
    nearest_depth = nearest_m / np.sqrt(1 + 1 / tall**2 + 1 / wide**2)
    near = max(max(float(depth.min()), nearest_depth) * (1 - DEPTH_MARGIN), far / MAX_DEPTH_RATIO)
    a, b = (far + near) / (far - near), -2 * far * near / (far - near)
    shift_x, shift_y = (1 - 2 * sample.x) / size[0], (1 - 2 * sample.y) / size[1]
    return np.array([[wide, 0, shift_x, 0], [0, tall, shift_y, 0], [0, 0, a, b], [0, 0, 1, 0]]) @ view
