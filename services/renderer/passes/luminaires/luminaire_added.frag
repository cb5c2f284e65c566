#version 430
// Adds radiance that was computed on the CPU.
uniform sampler2D computed;
uniform vec3 scale;
layout(location = 0) out vec4 radiance;

void main() { radiance = vec4(max(texelFetch(computed, ivec2(gl_FragCoord.xy), 0).rgb, 0.0) * scale, 0.0); }
