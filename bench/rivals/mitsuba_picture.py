"""Mitsuba 3 for comparison and as the reference of the renderer: our scenes in its form, lit by a lat-long map or by directional lights.

Mitsuba's LLVM variant traces its rays with Embree on all cores. Surfaces are Lambert with normalised Phong, two-sided, as our shaders have
them. The map keeps our registration: pixels are points at their centres, linear between them, nothing below the horizon.
"""

import os
from pathlib import Path
from typing import Any

import drjit as dr  # pyright: ignore[reportMissingImports]
import mitsuba as mi  # pyright: ignore[reportMissingImports]
import numpy as np

from vemlight.light.extent import Extents
from vemlight.light.light_set import LightSet
from vemlight.renderer.scene.materials import Phong
from vemlight.renderer.scene.scene import Scene

VARIANT = "llvm_ad_rgb"
LIBRARIES = ("libLLVM-19.so", "libLLVM.so.19.1", "libLLVM-15.so")  # in Debian's folder; 14, which it finds first, is too old
WORLD_FROM_ENVMAP = [[0, 0, -1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]  # its maps have +Y up and u = 0 at -Z


def start() -> None:
    """Selects Mitsuba's variant. Raises ImportError when it finds no LLVM."""
    found = [path for name in LIBRARIES if (path := Path("/usr/lib/x86_64-linux-gnu") / name).exists()]
    if found and "DRJIT_LIBLLVM_PATH" not in os.environ:
        os.environ["DRJIT_LIBLLVM_PATH"] = str(found[0])
    mi.set_variant(VARIANT)
    mi.set_log_level(mi.LogLevel.Error)  # it says when it rounds a number of samples up
    mi.register_bsdf("vemlight_phong", _phong())
    mi.register_integrator("vemlight_centred", _centred())


def _phong() -> type:
    """The surface model as a Mitsuba plugin, of the variant in use."""

    class TwoSidedPhong(mi.BSDF):
        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self._diffuse, self._specular = (mi.ScalarColor3f(props[key]) for key in ("diffuse", "specular"))
            self._exponent = float(props["exponent"])
            self.m_flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_components = [self.m_flags]

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            flat = si.to_local(si.n)
            before = dr.dot(flat, si.wi)
            side = dr.sign(before) * dr.sign(flat.z)
            mirrored = dr.maximum(dr.dot(mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z), wo), 1e-6)
            lobe = (self._exponent + 2) / (2 * dr.pi) * mirrored**self._exponent
            seen = active & (before * dr.dot(flat, wo) > 0) & (wo.z * side > 0)
            return (mi.Color3f(self._diffuse) / dr.pi + mi.Color3f(self._specular) * lobe) * dr.abs(wo.z) & seen

        def _side(self, si: Any) -> Any:
            """1 where the shading normal lies on the viewer's side of the surface, else -1."""
            flat = si.to_local(si.n)
            return dr.sign(dr.dot(flat, si.wi)) * dr.sign(flat.z)

        def _glossy_part(self) -> float:
            """Of the samples, those of the lobe: its part of what is reflected."""
            glossy, matte = dr.mean(self._specular), dr.mean(self._diffuse)
            return float(glossy / (glossy + matte)) if glossy > 0 else 0.0

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            part = self._glossy_part()
            cosine = dr.maximum(wo.z * self._side(si), 0)
            along = dr.maximum(dr.dot(mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z), wo), 0)
            lobe = (self._exponent + 1) / (2 * dr.pi) * along**self._exponent
            return (1 - part) * cosine / dr.pi + part * lobe & active

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            matte = mi.warp.square_to_cosine_hemisphere(sample2)
            matte.z *= self._side(si)
            height = dr.power(sample2.x, 1 / (self._exponent + 1))
            across, (sine, cosine) = dr.sqrt(dr.maximum(1 - height * height, 0)), dr.sincos(2 * dr.pi * sample2.y)
            around = mi.Frame3f(mi.Vector3f(-si.wi.x, -si.wi.y, si.wi.z))
            wo = dr.select(sample1 < self._glossy_part(), around.to_world(mi.Vector3f(across * cosine, across * sine, height)), matte)
            made = dr.zeros(mi.BSDFSample3f)
            made.wo, made.pdf, made.eta = wo, self.pdf(ctx, si, wo, active), 1.0
            made.sampled_type, made.sampled_component = mi.UInt32(+self.m_flags), 0
            value = self.eval(ctx, si, wo, active)
            return made, dr.select(made.pdf > 0, value / made.pdf, 0) & active

        def to_string(self) -> str:
            return "TwoSidedPhong[]"

    return TwoSidedPhong


def _centred() -> type:
    """Mitsuba's direct light, one emitter sample a path, with every camera ray through the centre of its pixel."""

    class CentredDirect(mi.SamplingIntegrator):
        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            width, height = scene.sensors()[0].film().size()
            pixel = dr.arange(mi.UInt32, dr.width(ray.o)) // sampler.sample_count()
            at = mi.Point2f((mi.Float(pixel % width) + 0.5) / width, (mi.Float(pixel // width) + 0.5) / height)
            ray = scene.sensors()[0].sample_ray(0.0, 0.0, at, mi.Point2f(0.5))[0]
            si = scene.ray_intersect(ray, active)
            seen = active & si.is_valid()
            to, weight = scene.sample_emitter_direction(si, sampler.next_2d(seen), True, seen)
            value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(to.d), seen)
            return value * weight & seen, seen, []

    return CentredDirect


def mitsuba_scene(scene: Scene, size: tuple[int, int], latlong: np.ndarray | None) -> Any:
    """A scene as Mitsuba has it, in a picture of `size`, lit by the upper hemisphere of a lat-long map (rows, cols, 3) if given."""
    camera = scene.camera
    to_world = mi.ScalarTransform4f().look_at(origin=list(camera.position), target=list(camera.at), up=[0, 0, 1])
    film = {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    made: dict[str, Any] = {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": camera.fov_y, "fov_axis": "y", "to_world": to_world, "film": film,
                   "near_clip": 1e-3, "far_clip": 1e4, "sampler": {"type": "multijitter", "sample_count": 4}},
        "integrator": METHODS["emitter"],
    }  # fmt: skip
    for number, mesh in enumerate(scene.meshes):
        material, geometry = mesh.material, mesh.geometry
        if not isinstance(material, Phong) or material.colour_map is not None:
            raise ValueError(f"{mesh.name}: only Phong without an image is known here")
        bsdf = mi.load_dict({"type": "vemlight_phong", "diffuse": mi.ScalarColor3f(material.diffuse),
                             "specular": mi.ScalarColor3f(material.specular), "exponent": float(material.exponent)})  # fmt: skip
        properties = mi.Properties()
        properties["bsdf"] = bsdf
        shape = mi.Mesh(f"mesh{number}", len(geometry.positions), len(geometry.triangles), props=properties, has_vertex_normals=True)
        table = mi.traverse(shape)
        table["vertex_positions"] = geometry.positions.astype(np.float32).ravel()
        table["vertex_normals"] = geometry.normals.astype(np.float32).ravel()
        table["faces"] = geometry.triangles.astype(np.uint32).ravel()
        table.update()
        made[f"mesh{number}"] = shape
    if latlong is not None:
        made["light"] = {"type": "envmap", "bitmap": mi.Bitmap(envmap(latlong)), "to_world": mi.ScalarTransform4f(WORLD_FROM_ENVMAP)}
    return mi.load_dict(made)


def envmap(latlong: np.ndarray) -> np.ndarray:
    """A lat-long map (rows, cols, 3) as Mitsuba reads it, (2 rows + 1, cols, 3) float32: row k at theta = k pi / (2 rows)."""
    rows, cols, _ = latlong.shape
    above = np.where(np.isfinite(latlong) & (latlong > 0), latlong, 0).astype(np.float32)
    above[rows // 2 :] = 0
    above = above[:, (cols // 2 - 1 - np.arange(cols)) % cols]  # by growing azimuth: longitude is pi - 2 pi u
    between = np.concatenate([above[:1], (above[1:] + above[:-1]) / 2, above[-1:]])
    made = np.empty((2 * rows + 1, cols, 3), np.float32)
    made[1::2], made[::2] = above, between
    return made


# Mitsuba's own integrators, in C++: direct light by samples of the map, of the surface or of both (power heuristic), and one bounce by
# paths, which take both.
METHODS: dict[str, dict[str, Any]] = {
    "emitter": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0, "hide_emitters": True},
    "bsdf": {"type": "direct", "emitter_samples": 0, "bsdf_samples": 1, "hide_emitters": True},
    "mis": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 1, "hide_emitters": True},
    "path": {"type": "path", "max_depth": 3, "rr_depth": 100, "hide_emitters": True},
}


def picture(scene: Any, samples: int, seed: int = 0, centred: bool = False, method: str = "emitter") -> np.ndarray:
    """What Mitsuba renders, (height, width, 3) float32, by `samples` paths a pixel of its multijitter sampler.

    centred: of the surfaces at the pixels' centres, not of their whole area, by samples of the map. method: of METHODS.
    """
    integrator = mi.load_dict({"type": "vemlight_centred"} if centred else METHODS[method])
    return np.array(mi.render(scene, integrator=integrator, spp=samples, seed=mi.UInt32(seed)))


class TracedLights:
    """Directional lights with shadow rays by Embree: primary rays once, then for each light one ray a pixel that faces it.

    A light with extent is met in a direction of its own distribution in each pixel, chosen at random.
    """

    def __init__(self, scene: Any, size: tuple[int, int]) -> None:
        self._scene, self._size = scene, size
        self._drawn = dr.freeze(self._draw)

    def picture(self, lights: LightSet, samples: int = 1, seed: int = 0) -> np.ndarray:
        """(height, width, 3) float32, at the pixels' centres or, of `samples` a pixel, over its whole area; seed: of random numbers."""
        extents = Extents.of(lights)
        mean = lights.directions * extents.concentrations[:, None]
        arrays = [mi.Vector3f(np.ascontiguousarray(rows.T, np.float32)) for rows in (mean, extents.axes[:, 0], extents.axes[:, 1])]
        irradiance = mi.Color3f(np.ascontiguousarray(lights.irradiance.T, np.float32))
        count, whole = mi.UInt32(len(lights.ids)), np.zeros((self._size[1], self._size[0], 3))
        for sample in range(samples):
            number = mi.UInt32(seed * samples + sample)
            area = mi.Float(0.0 if samples == 1 else 1.0)
            whole += np.array(self._drawn(self._scene, *arrays, irradiance, count, number, area)).T.reshape(whole.shape)
        return (whole / samples).astype(np.float32)

    @dr.syntax
    def _draw(self, scene: Any, means: Any, first: Any, second: Any, irradiance: Any, count: Any, seed: Any, area: Any) -> Any:
        width, height = self._size
        k = dr.arange(mi.UInt32, width * height)
        random = mi.PCG32(width * height, seed)
        x, y = area * (random.next_float32() - 0.5) + 0.5, area * (random.next_float32() - 0.5) + 0.5
        at = mi.Point2f((mi.Float(k % width) + x) / width, (mi.Float(k // width) + y) / height)
        ray, _ = scene.sensors()[0].sample_ray(0.0, 0.0, at, mi.Point2f(0.5))
        si = self._scene.ray_intersect(ray)
        found = si.is_valid()
        bsdf = si.bsdf()
        context = mi.BSDFContext()
        total = mi.Color3f(0)
        i = mi.UInt32(0)
        while i < count:
            p = mi.warp.square_to_std_normal(mi.Point2f(random.next_float32(), random.next_float32()))
            d = dr.gather(mi.Vector3f, means, i) + p.x * dr.gather(mi.Vector3f, first, i) + p.y * dr.gather(mi.Vector3f, second, i)
            d = dr.normalize(d)
            value = bsdf.eval(context, si, si.to_local(d), found)
            lit = found & (dr.max(value) > 0)
            lit &= ~scene.ray_test(si.spawn_ray(d), lit)
            total += value * dr.gather(mi.Color3f, irradiance, i) & lit
            i += 1
        return total
