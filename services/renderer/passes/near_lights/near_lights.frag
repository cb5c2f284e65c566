#version 430
// Adds near lights to the surfaces of a class. KIND: its kind of material. TRACED: what arrives of each lies in a layer; else in its maps. Of a shadow catcher the first target is what shadows take of
// their irradiance, the second what they give without shadows.
layout(early_fragment_tests) in;
#include "constants.glsl"
#include "near_light_struct.glsl"
#include "near_light.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "brdf.glsl"

uniform int light_count;
uniform float weight;  // of this pass in the picture: 1 / samples
#if TRACED
uniform sampler2DArray cached_visibility;
#else
#include "near_shadow_view.glsl"
#include "cube_faces.glsl"
#include "near_light_maps.glsl"
#endif
layout(location = 0) out vec4 radiance;
#if KIND == MATERIAL_SHADOW_CATCHER
uniform float part;  // of the pixel, that counts as a catcher now: weight, or 0 where another batch has counted it
layout(location = 1) out vec4 unshadowed;
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
#ifdef GL_ES  // which has no classes of pixels
    if (surface_position(pixel).w == 0.0 || int(surface_diffuse_at(pixel).kind + 0.5) != KIND) discard;
#endif
    vec3 position = surface_position(pixel).xyz;
    vec3 smooth_normal = surface_smooth_normal(pixel);
#if !TRACED
    vec3 flat_normal = surface_flat_normal(pixel);
#endif
#if KIND != MATERIAL_SHADOW_CATCHER
    Reflection surface = Reflection(surface_diffuse_at(pixel).albedo / PI, vec3(0.0), 0.0);
#endif
#if KIND == MATERIAL_PHONG || KIND == MATERIAL_GGX
    SurfaceSpecular specular = surface_specular_at(pixel);
    surface.reflectance = specular.reflectance;
    surface.lobe = specular.lobe;
    vec3 mirrored_view = reflect(normalize(pixel_ray()), smooth_normal);
    float view_cosine = max(dot(smooth_normal, mirrored_view), MIN_LOBE_COSINE);
    vec3 across = cross(smooth_normal, mirrored_view);
    across *= inversesqrt(max(dot(across, across), 1e-12));
#endif
    vec3 sum = vec3(0.0), whole = vec3(0.0);
    for (int i = 0; i < light_count; ++i) {
        NearView view = near_view(i, position, smooth_normal);
        float smooth_cosine = dot(smooth_normal, view.direction);
        float received = view.strength * near_received(smooth_cosine, view.sine);
        vec3 irradiance = min(near_lights[i].intensity * received, MAX_RADIANCE);
#if TRACED
        float fraction = texelFetch(cached_visibility, ivec3(pixel, int(near_lights[i].layer)), 0).r;
#else
        float fraction = near_visibility(i, position, flat_normal);
#endif
#if KIND == MATERIAL_SHADOW_CATCHER
        sum += irradiance * (1.0 - fraction);
        whole += irradiance;
#elif KIND == MATERIAL_LAMBERT
        sum += irradiance * surface.lambert * fraction;
#else
        float mirrored = dot(mirrored_view, view.direction);
        float between = 2.0 * view_cosine * smooth_cosine - mirrored;
        Reflected parts = reflected(KIND, surface, max(smooth_cosine, MIN_LOBE_COSINE), view_cosine, mirrored, between,
                                    dot(across, view.direction), 0.25 * view.sine * view.sine, 0.0);
        sum += irradiance * (parts.diffuse + parts.lobe) * fraction;
#endif
    }
    radiance = vec4(sum * weight, 0.0);
#if KIND == MATERIAL_SHADOW_CATCHER
    unshadowed = vec4(whole * weight, part);
#endif
}
