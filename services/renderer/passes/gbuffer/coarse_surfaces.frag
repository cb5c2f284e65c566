#version 430
// Takes every STEP-th pixel of every STEP-th row of a G-buffer.
#include "constants.glsl"
#include "surface_texels.glsl"

layout(location = 0) out float depth;
layout(location = 1) out vec4 normals;
layout(location = 2) out vec4 diffuse;
layout(location = 3) out vec4 specular;

void main() {
    ivec2 pixel = STEP * ivec2(gl_FragCoord.xy);
    depth = texelFetch(surface_depth, pixel, 0).r;
    normals = texelFetch(surface_normals, pixel, 0);
    diffuse = texelFetch(surface_diffuse, pixel, 0);
    specular = texelFetch(surface_specular, pixel, 0);
}
