"""Every buffer, vertex and texel that Python and the shaders share. `INCLUDES` holds the GLSL of each by the name that shaders include.

Python fills the fields of `NAME.dtype` by name; shaders read the struct of the same fields.
"""

import numpy as np

from vemlight.renderer.gl.constants import constants_glsl
from vemlight.renderer.gl.layout import Member, buffer_struct, texel_record, vertex_layout

# A light as Python hands it to light_frames.comp; its shadow map may have been drawn for a direction nearby.
LIGHT_ENTRY = buffer_struct(
    "LightEntry",
    {
        "direction": Member("vec3", "unit, to the light"),
        "resolution": Member("float", "texels on a side of its shadow map"),
        "irradiance": Member("vec3", "RGB, on a plane that faces the light"),
        "map": Member("float", "number of its shadow map"),
        "map_direction": Member("vec3", "unit, for which the shadow map was drawn"),
        "corner": Member("vec2", "first texel of the shadow map in the atlas"),
        "spread": Member("float", "rad, standard deviation of its directions along an axis; 0: a point"),
        "concentration": Member("float", "mean cosine of its directions with their middle; 1: a point"),
        "lobe_spread": Member("float", "rad^2, by which it widens lobes: its variance along an axis"),
        "least_width": Member("float", "rad^2, variance along an axis that a lobe with it has at least"),
        "direct": Member("float", "fraction of it that lobes reflect as a light; the prefiltered map has the rest"),
        "number": Member("float", "of the light in the frame's set"),
    },
)

# A light as the other shaders read it: light_frames.comp makes one of each entry.
LIGHT_FRAME = buffer_struct(
    "LightFrame",
    {
        "column": Member("vec4", "texel column in the light's shadow map = dot(column, world position)"),
        "row": Member("vec4", "likewise its texel row"),
        "depth": Member("vec4", "likewise its depth, 0 to FARTHEST_DEPTH, growing away from the light"),
        "direction": Member("vec3", "unit, to the light"),
        "bias": Member("float", "SHADOW_BIAS_TEXELS as a depth"),
        "irradiance": Member("vec3", "RGB, on a plane that faces the light"),
        "map": Member("float", "number of its shadow map"),
        "corner": Member("vec2", "first texel of the shadow map in the atlas"),
        "slope": Member("vec2", "depth a texel of a plane with normal n: slope * dot(column or row, n) / dot(direction, n)"),
        "resolution": Member("float", "texels on a side of the shadow map"),
        "spread": Member("float", "rad, standard deviation of its directions along an axis; 0: a point"),
        "concentration": Member("float", "mean cosine of its directions with their middle; 1: a point"),
        "lobe_spread": Member("float", "rad^2, by which it widens lobes: its variance along an axis"),
        "least_width": Member("float", "rad^2, variance along an axis that a lobe with it has at least"),
        "direct": Member("float", "fraction of it that lobes reflect as a light; the prefiltered map has the rest"),
    },
)

# A near light.
NEAR_LIGHT = buffer_struct(
    "NearLight",
    {
        "at": Member("vec3", "world"),
        "radius": Member("float", "metres, of the ball that it is"),
        "intensity": Member("vec3", "RGB, W/sr"),
        "layer": Member("float", "of visibility, or the number of its six maps"),
    },
)

# A shadow map of a near light: through a face of the cube about it.
NEAR_SHADOW_VIEW = buffer_struct(
    "NearShadowView",
    {
        "origin": Member("vec3", "world, the light"),
        "face": Member("float", "as ShadowView has it"),
        "low": Member("vec2", "window of tangents"),
        "high": Member("vec2", "below low: there is no map"),
        "corner": Member("vec2", "first texel of its tile"),
        "inverse_depths": Member("vec2", "1 / near and 1 / far"),
        "radius": Member("float", "metres, within which nothing casts"),
    },
)

# From where a shadow map of a luminaire is drawn, in the luminaire's frame.
SHADOW_VIEW = buffer_struct(
    "ShadowView",
    {
        "origin": Member("vec3", "metres"),
        "face": Member("float", "0 to 5: the face of a cube that it looks through, +z, -z, +x, -x, +y, -y"),
        "low": Member("vec2", "window of tangents"),
        "high": Member("vec2"),
    },
)

# A material's parameters in surface.frag; each model of surface_models.glsl reads some of them.
MATERIAL = buffer_struct(
    "Material",
    {
        "colour": Member("vec3", "albedo or base colour"),
        "kind": Member("float", "MATERIAL_..."),
        "specular": Member("vec3", "at normal incidence"),
        "exponent": Member("float", "of Phong's lobe"),
        "emissive": Member("vec3", "radiance"),
        "metallic": Member("float"),
        "roughness": Member("float"),
        "glossiness": Member("float"),
        "reflectance": Member("float", "at normal incidence, of what is no metal"),
        "alpha": Member("float", "coverage, times the texture's and the vertices'"),
        "alpha_cutoff": Member("float", "below it nothing is there; HASHED_ALPHA: alpha is a coverage"),
        "u_from_uvs": Member("vec4", "weights of both sets of texture coordinates in the u of each texture", 4),
        "v_from_uvs": Member("vec4", "likewise in its v", 4),
        "uv_offset": Member("vec4", "added to u and v; z and w are unused", 4),
    },
)

# The G-buffer.
SURFACE_DEPTH = texel_record("surface_depth", {"depth": Member("float", "in lengths of the pixel's ray; 0 where there is no surface")})
SURFACE_NORMALS = texel_record(
    "surface_normals",
    {
        "smooth_octahedron": Member("vec2", "normal for shading, in codes of 0 to 1; see normals.glsl"),
        "flat_octahedron": Member("vec2", "normal of the triangle; both are on the viewer's side"),
    },
)
SURFACE_DIFFUSE = texel_record("surface_diffuse", {"albedo": Member("vec3"), "kind": Member("float", "MATERIAL_...")})
SURFACE_SPECULAR = texel_record(
    "surface_specular",
    {"reflectance": Member("vec3", "at normal incidence"), "lobe": Member("float", "Phong's exponent or GGX' alpha, roughness squared")},
)
SURFACE_EMISSION = texel_record("surface_emission", {"radiance": Member("vec3"), "unused": Member("float")})

# Vertices: of the scene's meshes; their second texture coordinates; of what casts shadows, opaque and alpha-tested.
SCENE_VERTEX = vertex_layout(
    {"position": (np.float32, 3), "normal": (np.float32, 3), "uv": (np.float32, 2), "vertex_colour": (np.float16, 4)}
)
SECOND_UV = vertex_layout({"second_uv": (np.float32, 2)})
CASTER_VERTEX = vertex_layout({"position": (np.float32, 3)})
ALPHA_TESTED_VERTEX = vertex_layout({"position": (np.float32, 3), "alpha_uv": (np.float32, 2), "vertex_alpha": (np.float32, 1)})

INCLUDES = {
    "constants.glsl": constants_glsl(),
    "light_entry.glsl": LIGHT_ENTRY.glsl,
    "light_frame.glsl": LIGHT_FRAME.glsl,
    "near_light_struct.glsl": NEAR_LIGHT.glsl,
    "near_shadow_view.glsl": NEAR_SHADOW_VIEW.glsl,
    "shadow_view.glsl": SHADOW_VIEW.glsl,
    "material.glsl": MATERIAL.glsl,
    "surface_texels.glsl": "".join(
        record.glsl for record in (SURFACE_DEPTH, SURFACE_NORMALS, SURFACE_DIFFUSE, SURFACE_SPECULAR, SURFACE_EMISSION)
    ),
    "scene_vertex.glsl": SCENE_VERTEX.glsl + SECOND_UV.glsl,
    "caster_vertex.glsl": CASTER_VERTEX.glsl,
    "alpha_tested_vertex.glsl": ALPHA_TESTED_VERTEX.glsl,
}
