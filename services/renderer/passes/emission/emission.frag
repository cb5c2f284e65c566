#version 430
// Adds the radiance that surfaces emit.
uniform sampler2D surface_emission;
uniform float weight;  // of this pass in the picture
layout(location = 0) out vec4 radiance;

void main() { radiance = vec4(texelFetch(surface_emission, ivec2(gl_FragCoord.xy), 0).rgb * weight, 0.0); }
