"""What the camera sees where: its transforms, and the places in a pixel at which a picture is sampled."""

from typing import NamedTuple

import numpy as np

from vemlight.renderer.scene.scene import Scene, ViewCamera


class PixelSample(NamedTuple):
    """A sample of a pixel: where in the unit pixel, and its number among them, by which surfaces that are there in part are seen."""

    x: float
    y: float
    number: int = 0


def pixel_samples(samples: int) -> list[PixelSample]:
    """`samples` places in the unit pixel, evenly spread (Hammersley points, moved by half a step so that one lies in the middle)."""
    places = []
    for k in range(samples):
        mirrored, bit, rest = 0.0, 0.5, k
        while rest:
            mirrored, bit, rest = mirrored + bit * (rest & 1), bit / 2, rest >> 1
        places.append(PixelSample((k + 0.5) / samples, (mirrored + 0.5 / samples) % 1.0, k))
    return places


def view_from_world(camera: ViewCamera) -> np.ndarray:
    """Rigid transform (4, 4): x right, y down, z along the view; a camera that looks straight up or down has +Y of the world on top."""
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
    """(3, 3): from (x, y, 1) in a picture of `size` pixels, row 0 on top, pixel 0 from 0 to 1, to the world direction seen there."""
    tall = np.tan(np.radians(camera.fov_y) / 2)
    wide = tall * size[0] / size[1]
    view_from_pixel = np.array([[2 * wide / size[0], 0, -wide], [0, 2 * tall / size[1], -tall], [0, 0, 1]])
    return view_from_world(camera)[:3, :3].T @ view_from_pixel


PIXEL_CENTRE = PixelSample(0.5, 0.5)


def clip_from_world(scene: Scene, size: tuple[int, int], offset: PixelSample = PIXEL_CENTRE) -> np.ndarray:
    """Projection (4, 4) whose picture has row 0 on top in memory (y down) and is sampled at `offset` in each pixel of `size`.

    Near and far lie around the scene's box, near at least at 1/1000 of far so that 24 bits of depth stay fine enough.
    """
    view = view_from_world(scene.camera)
    corners = scene.centre + scene.half * np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    depth = corners @ view[2, :3] + view[2, 3]
    far = max(float(depth.max()) * 1.01, 1e-6)
    near = max(float(depth.min()) * 0.99, far / 1000)
    tall = 1 / np.tan(np.radians(scene.camera.fov_y) / 2)
    wide = tall * size[1] / size[0]
    a, b = (far + near) / (far - near), -2 * far * near / (far - near)
    shift_x, shift_y = (1 - 2 * offset[0]) / size[0], (1 - 2 * offset[1]) / size[1]
    return np.array([[wide, 0, shift_x, 0], [0, tall, shift_y, 0], [0, 0, a, b], [0, 0, 1, 0]]) @ view
