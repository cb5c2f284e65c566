#version 430
layout(early_fragment_tests) in;
// The back plate, stretched over the picture.
#include "compositing.glsl"

uniform sampler2D plate;
uniform vec2 size;  // of the picture, pixels
uniform float gain;
layout(location = 0) out vec4 radiance;

void main() { radiance = composited(texture(plate, gl_FragCoord.xy / size).rgb * gain); }
