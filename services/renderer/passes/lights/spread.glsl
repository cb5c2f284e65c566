// What a pixel takes of the weak lights that coarse pixels have received; after weak_lights.glsl. Irradiance goes by the pixel's own normal: it is to
// that of a coarse pixel as what both would have without shadows, roughly, by luminance.

uniform sampler2D coarse_weights;
uniform sampler2D coarse_light;
#ifdef GLOSSY
uniform sampler2D coarse_lobes;
uniform sampler2D coarse_unshadowed;
#endif

struct WeakLight {
    vec3 irradiance;
    vec3 lobes;
    vec2 lobe_visibility;
};

WeakLight weak_light(ivec2 pixel, vec3 normal) {
    vec4 weights = texelFetch(coarse_weights, pixel, 0);
    ivec2 first = pixel / STEP, last = textureSize(coarse_light, 0) - 1;
    WeakLight sum = WeakLight(vec3(0.0), vec3(0.0), vec2(0.0));
    for (int k = 0; k < 4; ++k) {
        ivec2 texel = min(first + ivec2(k & 1, k >> 1), last);
        sum.irradiance += weights[k] * texelFetch(coarse_light, texel, 0).rgb;
#ifdef GLOSSY
        vec4 there = texelFetch(coarse_lobes, texel, 0);
        sum.lobes += weights[k] * there.rgb;
        sum.lobe_visibility += weights[k] * vec2(there.a, texelFetch(coarse_unshadowed, texel, 0).r);
#endif
    }
    sum.irradiance *= unshadowed_by_normal(normal);
    return sum;
}
