#version 430
// The lobe of each pixel whose lobe has rays of its own, for rays.mirror: GGX' alpha, or Phong's exponent below 0; 0 elsewhere.
#include "constants.glsl"
#include "surface_texels.glsl"
#include "scene_rays.glsl"

layout(location = 0) out float polished;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int kind = int(surface_diffuse_at(pixel).kind + 0.5);
    float lobe = surface_specular_at(pixel).lobe;
    bool glossy = surface_depth_at(pixel).depth > 0.0 && (kind == MATERIAL_PHONG || kind == MATERIAL_GGX) && scene_rays(kind, lobe) > 0.0;
    polished = !glossy ? 0.0 : kind == MATERIAL_PHONG ? -lobe : lobe;
}
