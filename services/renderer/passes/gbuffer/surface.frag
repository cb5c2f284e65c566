#version 430
// Writes what each pixel sees, so that the lights are summed once for each visible surface. MODEL: the material's function of
// surface_models.glsl. TEXTURED: it has any texture; UV_TRANSFORM: they lie each in its own way; NORMAL_MAP: one is of normals. ALPHA_TEST:
// some of the surface is not there. EMISSION: something in the scene emits.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "material.glsl"
#include "surface_models.glsl"
#if ALPHA_TEST
#include "alpha_test.glsl"
uniform uint sample_number;
in vec3 rest_position;
in float surface_alpha;
#endif

uniform sampler2D colour_texture;
uniform sampler2D parameter_texture;
uniform sampler2D normal_texture;  // in the frame of the texture coordinates, 0 to 1 for -1 to 1
uniform sampler2D emissive_texture;
in vec3 world_position;
in vec3 surface_normal;
in vec2 surface_uv;
in vec3 surface_colour;
layout(location = 0) out float out_depth;
layout(location = 1) out vec4 out_normals;
layout(location = 2) out vec4 out_diffuse;
layout(location = 3) out vec4 out_specular;
#if EMISSION
layout(location = 4) out vec4 out_emission;
#endif

#ifdef SURFELS
in vec4 front_received;
in vec4 back_received;
#if EMISSION
layout(location = 5) out vec4 out_received;
#else
layout(location = 4) out vec4 out_received;
#endif
#endif

#if UV_TRANSFORM
in vec2 surface_second_uv;
vec2 texture_uv(int slot) {
    vec4 uvs = vec4(surface_uv, surface_second_uv);
    return vec2(dot(material.u_from_uvs[slot], uvs), dot(material.v_from_uvs[slot], uvs)) + material.uv_offset[slot].xy;
}
#else
#define texture_uv(slot) surface_uv
#endif
#if TEXTURED
#define TEXEL(sampler, slot) texture(sampler, texture_uv(slot))
#else
#define TEXEL(sampler, slot) vec4(1.0)
#endif

#if NORMAL_MAP
// The normal of the normal map. Its frame follows from how position and texture coordinates change over the picture (Schueler 2013), whichever
// way round the picture shows them.
vec3 mapped_normal(vec3 normal) {
    vec3 across = dFdx(world_position), down = dFdy(world_position);
    vec2 uv = texture_uv(TEXTURE_NORMAL), uv_across = dFdx(uv), uv_down = dFdy(uv);
    vec3 tangent_normal = 2.0 * texture(normal_texture, uv).xyz - 1.0;
    vec3 a = cross(down, normal), b = cross(normal, across);
    vec3 right = a * uv_across.x + b * uv_down.x, up = a * uv_across.y + b * uv_down.y;
    float size = sqrt(max(dot(right, right), dot(up, up)));
    if (size == 0.0) return normal;  // no texture coordinates
    float scale = dot(across, a) < 0.0 ? -1.0 / size : 1.0 / size;
    return normalize((right * tangent_normal.x + up * tangent_normal.y) * scale + normal * tangent_normal.z);
}
#endif

void main() {
    vec3 flat_normal = normalize(cross(dFdx(world_position), dFdy(world_position)));
    if (dot(flat_normal, eye - world_position) < 0.0) flat_normal = -flat_normal;
    vec3 smooth_normal = normalize(surface_normal);
    bool back_face = dot(smooth_normal, flat_normal) < 0.0;
#if NORMAL_MAP
    smooth_normal = mapped_normal(smooth_normal);
#endif
    if (back_face) smooth_normal = -smooth_normal;
#ifdef SURFELS
    vec4 received = back_face ? back_received : front_received;
    out_received = vec4(received.rgb / max(received.a, 1e-6), 1.0);
#endif

    vec4 texel = TEXEL(colour_texture, TEXTURE_COLOUR);
    SurfaceModel surface = MODEL(material.colour * surface_colour * texel.rgb, TEXEL(parameter_texture, TEXTURE_PARAMETER));

    vec3 ray = pixel_ray();
    out_depth = surface_depth_texel(dot(world_position - eye, ray) / dot(ray, ray));
    out_normals = surface_normals_texel(
        code_from_octahedron(octahedron_from_direction(smooth_normal)), code_from_octahedron(octahedron_from_direction(flat_normal)));
    out_diffuse = surface_diffuse_texel(surface.albedo, material.kind);
    out_specular = surface_specular_texel(surface.reflectance, surface.lobe);
#if EMISSION
    out_emission = surface_emission_texel(surface.emission * TEXEL(emissive_texture, TEXTURE_EMISSIVE).rgb, 0.0);
#endif
#if ALPHA_TEST
    float alpha = material.alpha * surface_alpha;
    float nearest = TEXTURED == 1 ? textureLod(colour_texture, texture_uv(TEXTURE_COLOUR), 0.0).a : 1.0;
    if (fails_alpha_test(alpha * nearest, alpha * texel.a, material.alpha_cutoff, rest_position, sample_number)) discard;
#endif
}
