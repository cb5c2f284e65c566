#version 430
// Brings what coarse pixels receive of weak lights to all pixels. Irradiance goes by the pixel's own normal: it is to that of a coarse pixel as
// what both would have without shadows, roughly, by luminance. CATCHERS: of shadow catchers, what shadows take. GLOSSY: with what lobes reflect.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "weak_lights.glsl"

uniform sampler2D coarse_weights;
uniform sampler2D coarse_light;
layout(location = 0) out vec4 radiance;
#if CATCHERS
uniform vec3 unshadowed;  // irradiance of a catcher without shadows
layout(location = 1) out vec4 matte;
#elif GLOSSY
uniform sampler2D coarse_lobes;
uniform sampler2D coarse_lobe_visibility;
layout(location = 1) out vec2 lobe_visibility;
#endif

const float MOST_TIMES = 4.0;  // that a pixel receives of its neighbours' light by its own normal: shadows do not stay alike beyond

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 weights = texelFetch(coarse_weights, pixel, 0);
    SurfaceDiffuse diffuse = surface_diffuse_at(pixel);
    bool catcher = int(diffuse.kind + 0.5) == MATERIAL_SHADOW_CATCHER;
    if (weights == vec4(0.0) || catcher != (CATCHERS == 1)) discard;
    float own = unshadowed_by_normal(surface_smooth_normal(pixel));
    ivec2 first = pixel / STEP, last = textureSize(coarse_light, 0) - 1;
    vec3 light = vec3(0.0), lobes = vec3(0.0);
    vec2 visibility = vec2(0.0);
    for (int k = 0; k < 4; ++k) {
        if (weights[k] == 0.0) continue;
        ivec2 texel = min(first + ivec2(k & 1, k >> 1), last);
        vec4 there = texelFetch(coarse_light, texel, 0);
        light += there.rgb * (weights[k] * min(own / there.a, MOST_TIMES));
#if GLOSSY && !CATCHERS
        lobes += weights[k] * texelFetch(coarse_lobes, texel, 0).rgb;
        visibility += weights[k] * texelFetch(coarse_lobe_visibility, texel, 0).rg;
#endif
    }
#if CATCHERS
    matte = vec4(light / unshadowed, dot(light, LUMINANCE_WEIGHTS) / dot(unshadowed, LUMINANCE_WEIGHTS));
    radiance = vec4(0.0, 0.0, 0.0, matte.a);
#else
    radiance = vec4((diffuse.albedo / 3.14159265 * light + lobes), 0.0);
#if GLOSSY
    lobe_visibility = visibility;
#endif
#endif
}
