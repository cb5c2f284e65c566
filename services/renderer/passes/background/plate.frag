#version 430
// A picture of the place behind everything, stretched over the picture.
#include "behind.glsl"

uniform sampler2D plate;
uniform vec2 size;  // of the picture, pixels
uniform float gain;
layout(location = 0) out vec4 radiance;

void main() {
    radiance = behind(texture(plate, gl_FragCoord.xy / size).rgb * gain);
}
