#version 430
// Adds what polished surfaces reflect of the scene, which rays have found: times the lobe's albedo, and the part that they have in it.
// HAS_PHONG, HAS_GGX: whether there are such surfaces.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "scene_rays.glsl"
#include "lobe_albedo.glsl"

uniform float weight;  // of this pass in the picture: 1 / samples
uniform sampler2D mirrored_scene;
layout(location = 0) out vec4 radiance;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 seen = texelFetch(mirrored_scene, pixel, 0);
    if (seen.a == 0.0) discard;
    int kind = int(surface_diffuse_at(pixel).kind + 0.5);
    SurfaceSpecular specular = surface_specular_at(pixel);
    float view = clamp(dot(surface_smooth_normal(pixel), -normalize(pixel_ray())), 1e-3, 1.0);
    vec3 reflected = vec3(0.0);
#if HAS_GGX
    if (kind == MATERIAL_GGX) reflected = ggx_albedo(specular.reflectance, specular.lobe, view);
#endif
#if HAS_PHONG
    float deviation = inversesqrt(max(specular.lobe, 0.0) + 2.0);
    if (kind == MATERIAL_PHONG) reflected = specular.reflectance * phong_cosine(view, deviation, phong_above(view, deviation));
#endif
    radiance = vec4(reflected * seen.rgb * (scene_rays(kind, specular.lobe) * weight), 0.0);
}
