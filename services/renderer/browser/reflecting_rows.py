"""What rays find on a scene's surfaces, as a browser reads it: the numbers of ReflectingMeshes, a row of texels a mesh."""

from typing import NamedTuple

import numpy as np

from vemlight.light.colour import srgb_from_linear
from vemlight.renderer.rays.reflecting import NONE, ReflectingMeshes, reduced
from vemlight.renderer.scene.materials import Material, alpha_test_of
from vemlight.renderer.scene.scene import Scene
from vemlight.runtime.flat_scene import REFLECTING_NUMBERS

UNLIT, CATCHER = 1, 2  # flags, added up
LEAST_ALPHA = 1e-6  # below a texel's smallest code times any cutoff
HALF_COVERED = 0.5  # of a surface with hashed alpha: rays see it where it covers more


class ReflectingRows(NamedTuple):
    """rows: (meshes, REFLECTING_NUMBERS) float32: colour, metallic; reflectance, flags; emission, cutoff of the alpha test, 0 without one;
    first texel (-1: none), rows, columns and whether it repeats (1 across + 2 up) of the colour's texture, and of the emission's.
    texels: (t, 4) uint8, colours coded by the sRGB curve, and their alpha. colour_uvs, emission_uvs: (n, 2) float32."""

    rows: np.ndarray
    texels: np.ndarray
    colour_uvs: np.ndarray
    emission_uvs: np.ndarray


def reflecting_rows(scene: Scene, meshes: ReflectingMeshes) -> ReflectingRows:
    """The rows of a scene's meshes."""
    rows = np.zeros((len(scene.meshes), REFLECTING_NUMBERS), np.float32)
    rows[:, 0:3], rows[:, 3], rows[:, 4:7] = meshes.colour, meshes.metallic, meshes.reflectance
    rows[:, 7], rows[:, 8:11] = UNLIT * meshes.unlit + CATCHER * meshes.catcher, meshes.emission
    rows[:, 11] = [_cutoff(mesh.material) for mesh in scene.meshes]
    for at, textures in ((12, meshes.colour_texture), (16, meshes.emission_texture)):
        rows[:, at] = NONE
        there = textures != NONE
        first, height, width, across, up = meshes.textures[textures[there]].T
        rows[there, at : at + 4] = np.stack([first, height, width, across + 2 * up], axis=-1)
    coded = np.concatenate([srgb_from_linear(np.clip(meshes.texels, 0, 1)), _alphas(scene, meshes)[:, None]], axis=-1)
    return ReflectingRows(rows, np.rint(255 * coded).astype(np.uint8), meshes.colour_uvs, meshes.emission_uvs)


def _alphas(scene: Scene, meshes: ReflectingMeshes) -> np.ndarray:
    """Of each texel the mean of what its colours cover, (t,) float32."""
    alphas = np.ones(len(meshes.texels), np.float32)
    for mesh, texture in zip(scene.meshes, meshes.colour_texture, strict=True):
        test = alpha_test_of(mesh.material)
        if test and test.image and texture != NONE:
            covered = reduced(test.image.texels[..., 3:])
            first, height, width = meshes.textures[texture, :3]
            if covered.shape[:2] == (height, width):
                alphas[first : first + covered.size] = covered.reshape(-1)
    return alphas


def _cutoff(material: Material) -> float:
    """Of a texel's coverage, below which rays go on; 0 where they never do. Without its alpha a material is nowhere."""
    test = alpha_test_of(material)
    if test is None:
        return 0.0
    return (HALF_COVERED if test.cutoff is None else test.cutoff) / max(test.alpha, LEAST_ALPHA)
