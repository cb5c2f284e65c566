#version 430
// What a polished pixel shows of the scene: the mean over its neighbours on the same surface, as their mirrored views lie in its lobe; alpha: the
// fraction of the lobe that meets something. rays/mirror.py has the law.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "scene_rays.glsl"
#include "mirror_laws.glsl"

uniform highp sampler2D mirrored;  // radiance of each pixel's ray
uniform highp sampler2D mirrored_places;  // w: 1 where it met something
layout(location = 0) out vec4 shown;

bool is_polished(ivec2 pixel, out int kind, out float lobe) {
    kind = int(surface_diffuse_at(pixel).kind + 0.5);
    lobe = surface_specular_at(pixel).lobe;
    return surface_depth_at(pixel).depth > 0.0 && (kind == MATERIAL_PHONG || kind == MATERIAL_GGX) && scene_rays(kind, lobe) > 0.0;
}

vec3 ray_of(ivec2 pixel) { return ray_from_pixel * vec3(vec2(pixel) + 0.5, 1.0); }

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy), last = textureSize(mirrored, 0) - 1;
    int kind;
    float lobe;
    if (!is_polished(pixel, kind, lobe)) discard;
    vec3 flat_normal = surface_flat_normal(pixel), place = surface_position(pixel).xyz, view = reflect(normalize(ray_of(pixel)), surface_smooth_normal(pixel));
    float variance = kind == MATERIAL_GGX ? 2.0 * lobe * lobe : 1.0 / (lobe + 2.0), near = SAME_PLANE * distance(place, eye), total = 0.0;
    vec4 sum = vec4(0.0);
    for (int y = -FILTER_REACH; y <= FILTER_REACH; ++y) {
        for (int x = -FILTER_REACH; x <= FILTER_REACH; ++x) {
            ivec2 other = pixel + ivec2(x, y);
            int its_kind;
            float its_lobe;
            if (any(lessThan(other, ivec2(0))) || any(greaterThan(other, last)) || !is_polished(other, its_kind, its_lobe)) continue;
            vec3 its_place = eye + surface_depth_at(other).depth * ray_of(other);
            if (abs(dot(flat_normal, its_place - place)) > near) continue;
            vec3 apart = reflect(normalize(ray_of(other)), surface_smooth_normal(other)) - view;
            float weight = (abs(x) == FILTER_REACH ? 1.0 : 2.0) * (abs(y) == FILTER_REACH ? 1.0 : 2.0) * exp(-dot(apart, apart) / (2.0 * variance));
            total += weight;
            sum += weight * vec4(texelFetch(mirrored, other, 0).rgb, texelFetch(mirrored_places, other, 0).w);
        }
    }
    shown = sum / total;
}
