#version 430
// For each surfel, in a texel, a ray over its hemisphere: the number of the surfel that it meets, SEES_SKY or SEES_INSIDE, of a closed mesh.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "scene_hits.glsl"
#include "surfel_laws.glsl"

uniform highp sampler2D ray_surfels;  // of each vertex the nearest surfel, and how much more it is on the back; below 0: the mesh is closed
uniform int ray;
uniform float lift;  // metres
layout(location = 0) out float link;

// Direction number k of `SURFEL_RAYS` about a normal in proportion to the cosine, turned by the surfel's number.
vec3 hemisphere_ray(int k, int surfel, vec3 n) {
    float side = n.z < 0.0 ? -1.0 : 1.0, a = -1.0 / (side + n.z), b = n.x * n.y * a;  // Duff et al. 2017
    vec3 right = vec3(1.0 + side * n.x * n.x * a, side * b, -side * n.x), up = vec3(b, side + n.y * n.y * a, -n.y);
    float inverse = 0.0, part = 0.5;  // van der Corput's sequence, base 2
    for (int bits = k; bits > 0; bits >>= 1, part *= 0.5) inverse += part * float(bits & 1);
    float own = fract(float(surfel) * 0.754877666), u = (float(k) + own) / float(SURFEL_RAYS);
    float turn = 6.2831853 * (inverse + fract(float(surfel) * 0.569840291));
    return sqrt(u) * (cos(turn) * right + sin(turn) * up) + sqrt(1.0 - u) * n;
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy) - ivec2(SURFEL_SIDE * ray, 0);
    vec4 place = surface_position(pixel);
    link = SEES_SKY;
    if (place.w == 0.0) return;
    vec3 normal = surface_smooth_normal(pixel), direction = hemisphere_ray(ray, SURFEL_SIDE * pixel.y + pixel.x, normal);
    SceneHit hit = nearest_hit(place.xyz + lift * normal, direction);
    if (hit.triangle < 0) return;
    vec3 a = ray_texel(ray_triangles, 3 * hit.triangle).xyz;
    vec3 front = cross(ray_texel(ray_triangles, 3 * hit.triangle + 1).xyz - a, ray_texel(ray_triangles, 3 * hit.triangle + 2).xyz - a);
    float first = 1.0 - hit.at.x - hit.at.y;
    ivec3 corners = triangle_vertices(hit.triangle);
    vec4 there = ray_texel(ray_surfels, first >= max(hit.at.x, hit.at.y) ? corners.x : hit.at.x >= hit.at.y ? corners.y : corners.z);
    bool back = dot(front, direction) > 0.0;
    link = !back ? there.x : there.y < 0.0 ? SEES_INSIDE : there.x + there.y;
}
