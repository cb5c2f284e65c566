#version 430
// Adds the gloss set to the lobes of glossy surfaces: the lights in the cone about the mirrored view, from the groups of the region that it
// lies in. Each is shadowed by the map of the shadowed light nearest to it, which its group has in common. HAS_PHONG, HAS_GGX: whether there
// are such surfaces.
#include "constants.glsl"
#include "light_frame.glsl"
#include "lights.glsl"
#if !CACHED_VISIBILITY
#include "visibility.glsl"
#endif
#include "arriving.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "brdf.glsl"
#include "gloss_cone.glsl"
#include "gloss_lights.glsl"

uniform float weight;  // of this pass in the picture: 1 / samples
uniform samplerCube region_of_direction;
layout(std140, binding = 1) readonly buffer Spans { GlossSpan spans[]; };  // of each region
layout(std140, binding = 2) readonly buffer Groups { GlossGroup groups[]; };
layout(std140, binding = 3) readonly buffer GlossLights { GlossLight gloss_lights[]; };
layout(location = 0) out vec4 radiance;

// A light is a disc, and a lobe is widened by its variance along an axis, a quarter of its radius squared. Phong's lobe has the variance
// 1 / exponent; GGX' halfway vectors, which move half as far as the light, have about alpha^2 / 2, so alpha^2 grows by 2 / 4 of the quarter.
const float DISC_VARIANCE = 0.25;

#if HAS_PHONG
vec3 widened_phong(SurfaceSpecular specular, float spread_squared, float mirrored) {
    return specular.reflectance * phong_lobe(1.0 / (1.0 / max(specular.lobe, 1e-3) + DISC_VARIANCE * spread_squared), mirrored);
}
#endif

#if HAS_GGX
vec3 widened_ggx(SurfaceSpecular specular, float spread_squared, float mirrored, float cosine, float view_cosine) {
    float alpha = sqrt(specular.lobe * specular.lobe + 0.5 * DISC_VARIANCE * spread_squared);
    vec2 lobe = ggx_lobe(cosine, view_cosine, 2.0 * view_cosine * cosine - mirrored, alpha);
    return mix(specular.reflectance, vec3(1.0), lobe.y) * lobe.x;
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = surface_position(pixel);
    int kind = int(surface_diffuse_at(pixel).kind);
    if (position.w == 0.0 || (kind != MATERIAL_PHONG && kind != MATERIAL_GGX)) discard;
    SurfaceSpecular specular = surface_specular_at(pixel);
    float taken = gloss_fraction(kind, specular.lobe);
    if (taken == 0.0) discard;
    vec3 smooth_normal = surface_smooth_normal(pixel);
    vec3 flat_normal = surface_flat_normal(pixel);
    vec3 mirrored_view = reflect(normalize(pixel_ray()), smooth_normal);
    float view_cosine = max(dot(smooth_normal, mirrored_view), MIN_LOBE_COSINE);
    GlossSpan span = spans[int(textureLod(region_of_direction, mirrored_view, 0.0).r)];

    vec3 sum = vec3(0.0);
    for (int g = span.first; g < span.first + span.count; ++g) {
        GlossGroup group = groups[g];
        vec3 part = vec3(0.0);
        for (int k = group.first; k < group.first + group.count; ++k) {
            vec3 direction = gloss_lights[k].direction;
            float mirrored = dot(mirrored_view, direction);
            float inside = in_cone(mirrored);
            float cosine = dot(smooth_normal, direction);
            if (inside <= 0.0 || cosine <= 0.0 || dot(flat_normal, direction) <= 0.0) continue;
            float spread_squared = gloss_lights[k].spread_squared;
#if HAS_PHONG && HAS_GGX
            vec3 lobe = kind == MATERIAL_PHONG ? widened_phong(specular, spread_squared, mirrored)
                                               : widened_ggx(specular, spread_squared, mirrored, cosine, view_cosine);
#elif HAS_PHONG
            vec3 lobe = widened_phong(specular, spread_squared, mirrored);
#else
            vec3 lobe = widened_ggx(specular, spread_squared, mirrored, cosine, view_cosine);
#endif
            part += gloss_lights[k].irradiance * lobe * (inside * cosine);
        }
        float facing = dot(flat_normal, lights[group.shadowing].direction);
        // Nothing is known of surfaces that face away from a light.
        sum += part * (facing > 0.0 ? arriving(group.shadowing, pixel, position, flat_normal, facing) : 1.0);
    }
    radiance = vec4(sum * (taken * weight), 0.0);
}
