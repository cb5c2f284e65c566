#version 430
// Follows a ray of each polished pixel along its lobe, and writes what it meets as surfaces for shade.frag: rays/mirror.py on the GPU.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "scene_rays.glsl"
#include "scene_hits.glsl"
#include "mirror_laws.glsl"

const float LEAST_COSINE = 0.1;  // of a view, below which rays begin no farther off; 0.05 to 0.2 would do

layout(location = 0) out vec4 place;  // w: 0 where the ray meets nothing
layout(location = 1) out vec4 normals;
layout(location = 2) out vec4 diffuse;
layout(location = 3) out vec4 emission;

// A direction of the lobe about the mirrored view, `u` in 0 to 1 from its middle outwards.
vec3 mirrored_ray(int kind, float lobe, vec3 normal, vec3 view, vec2 u) {
    vec3 axis = kind == MATERIAL_GGX ? normal : reflect(-view, normal);
    float side = axis.z < 0.0 ? -1.0 : 1.0, a = -1.0 / (side + axis.z), b = axis.x * axis.y * a;  // Duff et al. 2017
    vec3 right = vec3(1.0 + side * axis.x * axis.x * a, side * b, -side * axis.x), up = vec3(b, side + axis.y * axis.y * a, -axis.y);
    float slope = lobe * sqrt(u.x / (1.0 - u.x));
    float along = kind == MATERIAL_GGX ? inversesqrt(1.0 + slope * slope) : pow(1.0 - u.x, 1.0 / (1.0 + lobe));
    float outwards = sqrt(max(1.0 - along * along, 0.0)), turn = 6.2831853 * u.y;
    vec3 direction = along * axis + outwards * (cos(turn) * right + sin(turn) * up);
    return kind == MATERIAL_GGX ? 2.0 * dot(view, direction) * direction - view : direction;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    int kind = int(surface_diffuse_at(pixel).kind + 0.5);
    float lobe = surface_specular_at(pixel).lobe;
    vec4 position = surface_position(pixel);
    if (position.w == 0.0 || (kind != MATERIAL_PHONG && kind != MATERIAL_GGX) || scene_rays(kind, lobe) <= 0.0) discard;
    vec3 view = -normalize(pixel_ray()), flat_normal = surface_flat_normal(pixel);
    vec2 u = MIRROR_PATTERN[4 * (pixel.y & 3) + (pixel.x & 3)];
    vec3 direction = mirrored_ray(kind, lobe, surface_smooth_normal(pixel), view, vec2(MIRROR_MOST * u.x, u.y));
    direction -= min(2.0 * dot(flat_normal, direction), 0.0) * flat_normal;  // out of the surface
    // Rasterisers round edges to a 16th of a pixel, by which a place may lie beyond its triangle: farther where the view grazes it.
    vec3 from = position.xyz + flat_normal * (RAY_LIFT * distance(position.xyz, eye) / max(dot(flat_normal, view), LEAST_COSINE));
    SceneHit hit = nearest_hit(from, direction);
    if (hit.triangle < 0) discard;
    Found there = found(hit, direction);
    place = vec4(from + hit.distance * direction, 1.0);
    vec2 code = code_from_octahedron(octahedron_from_direction(there.normal));
    normals = vec4(code, code);
    diffuse = vec4(there.albedo, float(MATERIAL_LAMBERT));
    emission = vec4(there.emission, 1.0);
}
