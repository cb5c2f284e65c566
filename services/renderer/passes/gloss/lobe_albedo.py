"""The directional albedo of GGX' lobe: how much of light from all sides it reflects, a table over view cosine and roughness.

With Schlick's Fresnel term it is f0 * a + b (Karis 2013, Real Shading in Unreal Engine 4). GGX' slopes are m = alpha sqrt(u / (1 - u)) with
u even in 0 to 1, in even directions; the integral of BRDF times cosine is the mean over them of the Fresnel term times
G2 (v.h) / ((n.v) (n.h)).
"""

import numpy as np

from vemlight.renderer.gl.constants import MIN_ROUGHNESS

SIZE = 32  # entries in either direction: linear in the roughness and in the square root of the view cosine; between them 0.2 % off at most
MIN_VIEW_COSINE = 1e-3  # in place of 0, by which the lobe divides; any value in 1e-4 to 3e-3 does
STEPS, TURNS = 128, 24  # points of the quadrature: of u, and angles in half a turn


def ggx_albedo() -> np.ndarray:
    """(SIZE, SIZE, 2) float32: a and b. Rows: roughness from MIN_ROUGHNESS to 1; columns: view cosine."""
    even = np.arange(SIZE) / (SIZE - 1)
    roughness, view = MIN_ROUGHNESS + (1 - MIN_ROUGHNESS) * even, np.maximum(even**2, MIN_VIEW_COSINE).astype(np.float32)
    u, turn = (np.arange(STEPS) + 0.5) / STEPS, (np.arange(TURNS) + 0.5) * (np.pi / TURNS)
    slope = np.sqrt(u / (1 - u)).astype(np.float32)[:, None]
    along = (slope * np.cos(turn)).ravel().astype(np.float32)
    square = np.broadcast_to(slope**2, (STEPS, TURNS)).ravel()
    view = view[:, None]
    table = np.empty((SIZE, SIZE, 2), np.float32)
    for row, alpha in zip(table, (roughness**2).tolist(), strict=True):
        a2 = alpha * alpha
        height = 1 / np.sqrt(1 + a2 * square)  # of the halfway vector
        between = np.maximum(height * (view + np.sqrt(1 - view**2) * (alpha * along)), 0)
        light = np.maximum(2 * between * height - view, 0)
        smith = 2 * light * view / (light * np.sqrt(view**2 * (1 - a2) + a2) + view * np.sqrt(light**2 * (1 - a2) + a2))
        weight = between * smith / (view * height)
        grazing = weight * (1 - between) ** 5
        row[:, 0], row[:, 1] = (weight - grazing).mean(axis=1), grazing.mean(axis=1)
    return table
