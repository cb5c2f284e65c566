#version 430
// A level of the prefiltered map where there are no compute shaders: browsers.
#include "constants.glsl"
#include "normals.glsl"
#include "octahedral_map.glsl"
#include "prefilter.glsl"

uniform float side;  // texels
layout(location = 0) out vec4 prefiltered;

void main() { prefiltered = vec4(prefiltered_texel(gl_FragCoord.xy, side), 1.0); }
