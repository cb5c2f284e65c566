#version 430
// Reinhard's global operator or an exponential one, and the sRGB curve: `tone_mapped` of tonemap.py.

uniform sampler2D picture;
uniform float scale;
uniform float white;
uniform bool exponential;
layout(location = 0) out vec4 screen;

void main() {
    vec4 pixel = texelFetch(picture, ivec2(gl_FragCoord.xy), 0);
    float alpha = clamp(pixel.a, 0.0, 1.0);
    vec3 colour = vec3(0.0);
    for (int c = 0; c < 3; ++c) {
        if (alpha > 0.0 && pixel[c] > 0.0 && !isnan(pixel[c])) colour[c] = min(pixel[c] / alpha, 1e30);  // drivers differ in nan > 0
    }
    float level = scale * dot(colour, vec3(0.2126, 0.7152, 0.0722));
    float kept = (1.0 + level / (white * white)) / (1.0 + level);
    if (exponential) kept = level > 1e-3 ? (1.0 - exp(-level)) / level : 1.0 - 0.5 * level;  // the series is good to 2e-7 there
    colour = clamp(scale * colour * kept, 0.0, 1.0);
    vec3 encoded = mix(1.055 * pow(colour, vec3(1.0 / 2.4)) - 0.055, 12.92 * colour, lessThanEqual(colour, vec3(0.0031308)));
    screen = vec4(encoded, alpha);
}
