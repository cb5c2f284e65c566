#version 430
// Sums a row of lights for each surface of a class: KIND 0 is Lambert, 1 adds normalised Phong, 2 is GGX as glTF has it; 3 catches
// shadows: its cover is the share of the light that they take, in each channel, its alpha the same in luminance. Each light with its
// shadow map, looked up here or CACHED_VISIBILITY.

layout(early_fragment_tests) in;
#include "light.glsl"
#include "lights.glsl"
#if CACHED_VISIBILITY
uniform sampler2DArray cached_visibility;  // a layer for each tile
#else
#include "visibility.glsl"
#endif
#include "normals.glsl"
#include "gbuffer.glsl"

uniform int light_count;
uniform float weight;  // of this pass in the picture: 1 / samples
layout(location = 0) out vec4 radiance;

#if KIND == 3
uniform vec3 unshadowed;  // what the lights give to a catcher without shadows
layout(location = 1) out vec4 cover;
const vec3 LUMINANCE = vec3(0.2126, 0.7152, 0.0722);
#else
#include "brdf.glsl"
uniform float alpha;  // of this pass in the picture's
uniform sampler2D surface_diffuse;
#endif
#if KIND == 1 || KIND == 2
#include "cone.glsl"
uniform sampler2D surface_specular;
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = seen_position();
    vec4 normals = seen_normals();
    vec3 smooth_normal = direction_from_octahedron(normals.xy);
    vec3 flat_normal = direction_from_octahedron(normals.zw);
#if KIND < 3
    vec3 lambert = texelFetch(surface_diffuse, pixel, 0).rgb / PI;
#endif
#if KIND == 1 || KIND == 2
    vec4 specular = texelFetch(surface_specular, pixel, 0);
    vec3 mirrored_view = reflect(normalize(seen_ray()), smooth_normal);
    float view_cosine = max(dot(smooth_normal, mirrored_view), 1e-4);
#endif

#if KIND == 1
    float narrow = narrow_phong(specular.w);
#elif KIND == 2
    float narrow = narrow_ggx(specular.w);
#endif

    vec3 sum = vec3(0.0);
    for (int i = 0; i < light_count; ++i) {
        vec3 d = lights[i].direction.xyz;
        float flat_cosine = dot(flat_normal, d);
        float cosine = flat_cosine > 0.0 ? max(dot(smooth_normal, d), 0.0) : 0.0;
#if CACHED_VISIBILITY
        float seen = texelFetch(cached_visibility, ivec3(pixel, int(lights[i].irradiance.w)), 0).r;
#else
        float seen = visibility(i, position, flat_normal, flat_cosine);
#endif
#if KIND == 3
        sum += lights[i].irradiance.rgb * (cosine * (1.0 - seen));
#else
#if KIND == 0
        vec3 brdf = lambert;
#else
        float mirrored = dot(mirrored_view, d);
        float own = 1.0 - narrow * in_cone(mirrored);
#endif
#if KIND == 1
        vec3 brdf = lambert + specular.rgb * (own * phong_lobe(specular.w, mirrored));
#elif KIND == 2
        vec2 lobe = ggx_lobe(specular.w, max(cosine, 1e-4), view_cosine, 2.0 * view_cosine * cosine - mirrored);
        vec3 fresnel = mix(specular.rgb, vec3(1.0), lobe.y);
        vec3 brdf = lambert * (1.0 - fresnel) + fresnel * (own * lobe.x);
#endif
        sum += lights[i].irradiance.rgb * brdf * (cosine * seen);
#endif
    }
#if KIND == 3
    cover = vec4(sum / unshadowed, dot(sum, LUMINANCE) / dot(unshadowed, LUMINANCE)) * weight;
    radiance = vec4(0.0, 0.0, 0.0, cover.a);
#else
    radiance = vec4(sum * weight, alpha);
#endif
}
