#version 430
layout(early_fragment_tests) in;
// EDGES: of pixels that have parts of their neighbours' colours.
// Reinhard's global operator or an exponential one, and the sRGB curve: `tone_mapped` of tonemap.py.
#include "constants.glsl"
#include "colour.glsl"

uniform sampler2D picture;
uniform float scale;
uniform float white;
uniform bool exponential;
layout(location = 0) out vec4 pixel;

// Where 1 - exp(-x) cancels in float32 its series takes over: x - x^2 / 2 leaves x^2 / 6, 2e-7 of x there. Any value in 1e-4 to 1e-2 does.
const float SERIES_END = 1e-3;

#if EDGES
uniform sampler2D edges_before;  // parts of the neighbours in the row below in memory, and of that to the left
uniform sampler2D edges_after;  // of that to the right, and in the row above

vec4 shown(ivec2 pixel) {
    vec4 before = texelFetch(edges_before, pixel, 0), after = texelFetch(edges_after, pixel, 0), sum = vec4(0.0);
    float own = 1.0 - dot(before + after, vec4(1.0));
    const ivec2 STEPS[8] = ivec2[](ivec2(-1, -1), ivec2(0, -1), ivec2(1, -1), ivec2(-1, 0), ivec2(1, 0), ivec2(-1, 1), ivec2(0, 1), ivec2(1, 1));
    for (int k = 0; k < 8; ++k) {
        float part = k < 4 ? before[k] : after[k - 4];
        if (part > 0.0) sum += part * texelFetch(picture, pixel + STEPS[k], 0);
    }
    return sum + own * texelFetch(picture, pixel, 0);
}
#else
vec4 shown(ivec2 pixel) { return texelFetch(picture, pixel, 0); }
#endif

void main() {
    vec4 linear = shown(ivec2(gl_FragCoord.xy));
    float alpha = clamp(linear.a, 0.0, 1.0);
    vec3 colour = vec3(0.0);
    for (int c = 0; c < 3; ++c) {
        bool positive = linear[c] > 0.0 && !isnan(linear[c]);  // drivers differ in nan > 0
        if (alpha > 0.0 && positive) colour[c] = min(linear[c] / alpha, MAX_RADIANCE);
    }
    float level = scale * luminance_from_rgb(colour);
    float gain = (1.0 + level / (white * white)) / (1.0 + level);
    if (exponential) gain = level > SERIES_END ? (1.0 - exp(-level)) / level : 1.0 - 0.5 * level;
    pixel = vec4(srgb_from_linear(clamp(scale * colour * gain, 0.0, 1.0)), alpha);
}
