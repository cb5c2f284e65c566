#version 430
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

void main() {
    vec4 linear = texelFetch(picture, ivec2(gl_FragCoord.xy), 0);
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
