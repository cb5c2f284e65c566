#version 430
// Sums a row of lights for each surface of a class. KIND: its kind of material. A shadow catcher's matte is what shadows take of its light, in
// each channel, its alpha the same in luminance. COARSE: irradiance, over what there would be by the normal without shadows, and what lobes reflect, for weak_lights.py. WEAK: with what
// coarse pixels have received so.

#if !COARSE
layout(early_fragment_tests) in;
#endif
#include "constants.glsl"
#include "light_frame.glsl"
#include "lights.glsl"
#if !CACHED_VISIBILITY
#include "visibility.glsl"
#endif
#include "arriving.glsl"
#include "received.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"

uniform int light_count;
uniform float weight;  // of this pass in the picture: 1 / samples
layout(location = 0) out vec4 radiance;
#if COARSE || WEAK
#include "weak_lights.glsl"
#endif

#if KIND == MATERIAL_SHADOW_CATCHER && !COARSE
uniform vec3 unshadowed;  // irradiance of a catcher without shadows
layout(location = 1) out vec4 matte;
#elif KIND != MATERIAL_SHADOW_CATCHER
#include "brdf.glsl"
uniform float alpha;  // that this pass adds to the picture's
#endif
#if KIND == MATERIAL_PHONG || KIND == MATERIAL_GGX
#define GLOSSY
#include "lobe_sources.glsl"
// What the lobe would reflect of the lights that the prefiltered map has, in luminance: with shadows and without.
#if COARSE
layout(location = 1) out vec4 lobes;  // alpha: with shadows
layout(location = 2) out float unshadowed_lobes;
#else
layout(location = 1) out vec2 lobe_visibility;
#endif
#endif
#if WEAK
#include "spread.glsl"
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
#if COARSE || defined(GL_ES)  // which has no classes of pixels
    if (surface_position(pixel).w == 0.0 || int(surface_diffuse_at(pixel).kind + 0.5) != KIND) discard;
#endif
    vec4 position = surface_position(pixel);
    vec3 smooth_normal = surface_smooth_normal(pixel);
    vec3 flat_normal = surface_flat_normal(pixel);
#if KIND != MATERIAL_SHADOW_CATCHER
    Reflection surface = Reflection(COARSE == 1 ? vec3(1.0) : surface_diffuse_at(pixel).albedo / PI, vec3(0.0), 0.0);
#endif
#ifdef GLOSSY
    SurfaceSpecular specular = surface_specular_at(pixel);
    surface.reflectance = specular.reflectance;
    surface.lobe = specular.lobe;
    vec3 mirrored_view = reflect(normalize(pixel_ray()), smooth_normal);
    float view_cosine = max(dot(smooth_normal, mirrored_view), MIN_LOBE_COSINE);
    vec3 across = cross(smooth_normal, mirrored_view);
    across *= inversesqrt(max(dot(across, across), 1e-12));
    float of_map = map_fraction(KIND, specular.lobe);
    vec3 lobe_sum = vec3(0.0);
    vec2 visibility = vec2(0.0);
#endif

    vec3 sum = vec3(0.0);
    for (int i = 0; i < light_count; ++i) {
        vec3 d = lights[i].direction;
        float flat_cosine = dot(flat_normal, d);
        float smooth_cosine = dot(smooth_normal, d);
        float cosine = received(i, smooth_cosine);
        float fraction = arriving(i, pixel, position, flat_normal, flat_cosine);
#if KIND == MATERIAL_SHADOW_CATCHER
        sum += lights[i].irradiance * (cosine * (1.0 - fraction));
#else
#ifdef GLOSSY
        float mirrored = dot(mirrored_view, d);
        float between = 2.0 * view_cosine * smooth_cosine - mirrored;
        float lit_cosine = max(smooth_cosine, MIN_LOBE_COSINE), direct = mix(1.0, lights[i].direct, of_map);
        Reflected parts = reflected(KIND, surface, lit_cosine, view_cosine, mirrored, between, dot(across, d),
                                    lights[i].lobe_spread * of_map, lights[i].least_width * of_map);
#if COARSE
        sum += lights[i].irradiance * parts.diffuse * (cosine * fraction);
        lobe_sum += lights[i].irradiance * parts.lobe * (direct * cosine * fraction);
#else
        sum += lights[i].irradiance * (parts.diffuse + parts.lobe * direct) * (cosine * fraction);
#endif
        visibility += vec2(fraction, 1.0) * (dot(lights[i].irradiance * parts.lobe, LUMINANCE_WEIGHTS) * cosine * (1.0 - direct));
#else
        sum += lights[i].irradiance * surface.lambert * (cosine * fraction);
#endif
#endif
    }
#if COARSE
    radiance = vec4(sum / unshadowed_by_normal(smooth_normal), 0.0);
#ifdef GLOSSY
    lobes = vec4(lobe_sum, visibility.x);
    unshadowed_lobes = visibility.y;
#endif
    return;
#endif
#if WEAK
    WeakLight weak = weak_light(pixel, smooth_normal);
#if KIND == MATERIAL_SHADOW_CATCHER
    sum += weak.irradiance;
#else
    sum += weak.irradiance * surface.lambert + weak.lobes;
#endif
#ifdef GLOSSY
    visibility += weak.lobe_visibility;
#endif
#endif
#if !COARSE
#ifdef GLOSSY
    lobe_visibility = visibility;
#endif
#if KIND == MATERIAL_SHADOW_CATCHER
    matte = vec4(sum / unshadowed, dot(sum, LUMINANCE_WEIGHTS) / dot(unshadowed, LUMINANCE_WEIGHTS)) * weight;
    radiance = vec4(0.0, 0.0, 0.0, matte.a);
#else
    radiance = vec4(sum * weight, alpha);
#endif
#endif
}
