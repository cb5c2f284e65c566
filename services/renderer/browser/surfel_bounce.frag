#version 430
// Adds what surfaces send to each other: what each pixel receives of it, reflected evenly, and by wide lobes as if it came evenly from before the surface.
#include "constants.glsl"
#include "surface_texels.glsl"
#include "scene_rays.glsl"

uniform highp sampler2D surface_received;
layout(location = 0) out vec4 radiance;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    SurfaceDiffuse diffuse = surface_diffuse_at(pixel);
    SurfaceSpecular specular = surface_specular_at(pixel);
    int kind = int(diffuse.kind + 0.5);
    if (surface_depth_at(pixel).depth == 0.0 || kind == MATERIAL_SHADOW_CATCHER) discard;
    vec3 evenly = texelFetch(surface_received, pixel, 0).rgb / 3.14159265;
    radiance = vec4((diffuse.albedo + specular.reflectance * (1.0 - scene_rays(kind, specular.lobe))) * evenly, 0.0);
}
