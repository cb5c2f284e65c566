"""Light regions (Havran et al. 2005, section 4.1): which lights can reach a surface, by its normal.

The sphere of normals is covered by overlapping caps about fixed centres. A cube map gives the cap of a normal, and each cap has a row with
the lights that reach any normal in it, in the order of the lights, so that a prefix of the lights is a prefix of each row.
"""

from typing import NamedTuple

import numpy as np

CUBE_SIDE = 32  # texels of a face: 2.8 degrees, small beside caps of 20 to 40 degrees
SPHERE_REGIONS = 24  # for lights from all sides: a quarter less to sum; a ground sees all lights of a hemisphere
ROUNDING = 1e-3  # rad; a normal on the rim of a texel may be looked up in its neighbour. Any value in 1e-5 to 1e-2 does


class Regions(NamedTuple):
    """centres: (n, 3) float32. reach: (n,) float32 rad, the farthest a normal in the cap lies from its centre.

    cube: (6, CUBE_SIDE, CUBE_SIDE) uint8, faces and texels in OpenGL's order, the cap of each normal.
    """

    centres: np.ndarray
    reach: np.ndarray
    cube: np.ndarray


def light_regions(count: int) -> Regions:
    """`count` regions about evenly spread centres (a Fibonacci spiral); 0 makes one region that holds every normal."""
    if count == 0:
        return Regions(np.array([[0, 0, 1]], np.float32), np.array([np.pi], np.float32), np.zeros((6, CUBE_SIDE, CUBE_SIDE), np.uint8))
    k = np.arange(count) + 0.5
    z, phi = 1 - 2 * k / count, k * np.pi * (3 - np.sqrt(5))
    s = np.sqrt(1 - z * z)
    centres = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)
    edge = np.linspace(-1, 1, CUBE_SIDE + 1)
    corners = _cube_directions(edge, edge)
    middles = _cube_directions((edge[1:] + edge[:-1]) / 2, (edge[1:] + edge[:-1]) / 2)
    cube = np.argmax(middles @ centres.T, axis=-1)
    reach = np.zeros(count)
    for rows in (slice(None, -1), slice(1, None)):  # a texel's farthest point from a centre is one of its corners
        for cols in (slice(None, -1), slice(1, None)):
            angle = np.arccos(np.clip(np.einsum("frcx,frcx->frc", corners[:, rows, cols], centres[cube]), -1, 1))
            np.maximum.at(reach, cube.reshape(-1), angle.reshape(-1))
    return Regions(centres.astype(np.float32), (reach + ROUNDING).astype(np.float32), cube.astype(np.uint8))


def region_rows(regions: Regions, directions: np.ndarray) -> list[np.ndarray]:
    """For each region the numbers of the lights, (k,) int64 ascending, that can shine on a normal in it; directions (n, 3)."""
    # A light is on the dark side of every normal of a cap when it lies farther than reach + 90 degrees from the centre.
    least = np.where(regions.reach < np.pi / 2, -np.sin(np.minimum(regions.reach, np.pi / 2)), -2.0)
    return [np.flatnonzero(row) for row in regions.centres @ directions.T >= least[:, None]]


def _cube_directions(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Unit vectors (6, len(t), len(s), 3) through face coordinates s, t in [-1, 1]; OpenGL 4.3, table 8.18: +x -x +y -y +z -z."""
    s, t = np.meshgrid(s, t)
    one = np.ones_like(s)
    faces = [(one, -t, -s), (-one, -t, s), (s, one, t), (s, -one, -t), (s, -t, one), (-s, -t, -one)]
    directions = np.stack([np.stack(face, axis=-1) for face in faces])
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)
