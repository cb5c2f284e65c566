#version 430
// Writes each pixel's class as a depth: by the light region of its normal and its kind of material, nothing where there is no surface.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"

uniform samplerCube region_of_normal;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float region = texture(region_of_normal, surface_smooth_normal(pixel)).r;
    float number = MATERIAL_KINDS * region + surface_diffuse_at(pixel).kind;
    gl_FragDepth = surface_depth_at(pixel).depth > 0.0 ? (number + 0.5) / CLASSES : 1.0;
}
