// Where rays meet the scene, and what they find there: a balanced tree of boxes over its triangles (relit_rays.js), and a row of numbers for each
// mesh (reflecting_rows.py). All lie in textures of 2^WIDTH_BITS texels a row.

uniform highp sampler2D ray_boxes;  // two texels a box, low and high; those of box i are boxes 2 i and 2 i + 1, the first is number 1
uniform highp sampler2D ray_triangles;  // three texels each, a corner and its vertex's number; below 0: it has holes
uniform highp sampler2D ray_vertices;  // two texels each: where it lies in the colour's and in the emission's texture; colour and mesh
uniform highp sampler2D ray_meshes;  // five texels each
uniform highp sampler2D reflecting_texels;
uniform vec3 ground;  // albedo of shadow catchers
uniform int first_leaf;  // number of the box with the first LEAF triangles

const float NOTHING = 1e30;  // how far a ray that meets nothing goes
const float ON_EDGE = 1e-5;  // in barycentric coordinates: rays pass between no neighbours
const float FLAG_UNLIT = 1.0, FLAG_CATCHER = 2.0;

vec4 ray_texel(highp sampler2D numbers, int at) { return texelFetch(numbers, ivec2(at & ((1 << WIDTH_BITS) - 1), at >> WIDTH_BITS), 0); }

struct SceneHit {
    float distance;
    int triangle;  // -1: none
    vec2 at;  // barycentric coordinates of its second and third corner
};

// Where a ray enters a box, or NOTHING.
float box_entry(int box, vec3 from, vec3 inverse, float farthest) {
    vec3 a = (ray_texel(ray_boxes, 2 * box).xyz - from) * inverse, b = (ray_texel(ray_boxes, 2 * box + 1).xyz - from) * inverse;
    vec3 low = min(a, b), high = max(a, b);
    float entry = max(max(low.x, low.y), max(low.z, 0.0));
    return entry <= min(min(high.x, high.y), min(high.z, farthest)) ? entry : NOTHING;
}

// Of the texture in texels number `row` of a mesh, at some coordinates.
vec4 reflecting_texel(int mesh, int row, vec2 uv) {
    vec4 image = ray_texel(ray_meshes, 5 * mesh + row);
    if (image.x < 0.0) return vec4(1.0);
    ivec2 size = ivec2(image.zy), at = ivec2(floor(uv * vec2(size))), repeats = ivec2(int(image.w) & 1, int(image.w) >> 1);
    ivec2 around = at - size * ivec2(floor(vec2(at) / vec2(size))), inside = clamp(at, ivec2(0), size - 1);
    at = ivec2(repeats.x == 1 ? around.x : inside.x, repeats.y == 1 ? around.y : inside.y);
    return ray_texel(reflecting_texels, int(image.x) + at.y * size.x + at.x);
}

// The vertices of a triangle, and its mesh.
ivec3 triangle_vertices(int triangle) {
    vec3 numbers = vec3(ray_texel(ray_triangles, 3 * triangle).w, ray_texel(ray_triangles, 3 * triangle + 1).w, ray_texel(ray_triangles, 3 * triangle + 2).w);
    if (numbers.x < 0.0) numbers.x = -1.0 - numbers.x;
    return ivec3(numbers + 0.5);
}
int vertex_mesh(int vertex) { return int(ray_texel(ray_vertices, 2 * vertex + 1).w + 0.5); }

vec2 mixed(vec2 a, vec2 b, vec2 c, vec2 at) { return a * (1.0 - at.x - at.y) + b * at.x + c * at.y; }

bool is_hole(int triangle, vec2 at) {
    ivec3 corners = triangle_vertices(triangle);
    int mesh = vertex_mesh(corners.x);
    vec2 uv = mixed(ray_texel(ray_vertices, 2 * corners.x).xy, ray_texel(ray_vertices, 2 * corners.y).xy, ray_texel(ray_vertices, 2 * corners.z).xy, at);
    return reflecting_texel(mesh, 3, uv).a < ray_texel(ray_meshes, 5 * mesh + 2).w;
}

// Moeller and Trumbore 1997, both sides.
void meet_triangle(int triangle, vec3 from, vec3 direction, inout SceneHit hit) {
    vec4 a = ray_texel(ray_triangles, 3 * triangle);
    vec3 u = ray_texel(ray_triangles, 3 * triangle + 1).xyz - a.xyz, v = ray_texel(ray_triangles, 3 * triangle + 2).xyz - a.xyz;
    vec3 p = cross(direction, v);
    float volume = dot(u, p);
    if (volume == 0.0) return;
    vec3 s = from - a.xyz, q = cross(s, u);
    vec2 at = vec2(dot(s, p), dot(direction, q)) / volume;
    float along = dot(v, q) / volume;
    if (min(at.x, at.y) < -ON_EDGE || at.x + at.y > 1.0 + ON_EDGE || !(along > 0.0 && along < hit.distance)) return;
    if (a.w < 0.0 && is_hole(triangle, at)) return;
    hit = SceneHit(along, triangle, at);
}

SceneHit nearest_hit(vec3 from, vec3 direction) {
    SceneHit hit = SceneHit(NOTHING, -1, vec2(0.0));
    vec3 inverse = 1.0 / mix(direction, vec3(1e-9), lessThan(abs(direction), vec3(1e-9)));
    int waiting[24];
    float entries[24];
    int count = 0, box = 1;
    for (;;) {
        if (box >= first_leaf) {
            int first = LEAF * (box - first_leaf);
            for (int own = 0; own < LEAF; ++own) meet_triangle(first + own, from, direction, hit);
        } else {
            float left = box_entry(2 * box, from, inverse, hit.distance), right = box_entry(2 * box + 1, from, inverse, hit.distance);
            bool swapped = right < left;
            if (max(left, right) < NOTHING) {
                waiting[count] = 2 * box + (swapped ? 0 : 1);
                entries[count++] = max(left, right);
            }
            if (min(left, right) < NOTHING) {
                box = 2 * box + (swapped ? 1 : 0);
                continue;
            }
        }
        while (count > 0 && entries[count - 1] >= hit.distance) --count;
        if (count == 0) break;
        box = waiting[--count];
    }
    return hit;
}

// What a ray finds where it meets a surface.
struct Found {
    vec3 normal;  // of the triangle, on the ray's side
    vec3 albedo;
    vec3 emission;
};

Found found(SceneHit hit, vec3 direction) {
    ivec3 corners = triangle_vertices(hit.triangle);
    vec3 a = ray_texel(ray_triangles, 3 * hit.triangle).xyz;
    vec3 normal = normalize(cross(ray_texel(ray_triangles, 3 * hit.triangle + 1).xyz - a, ray_texel(ray_triangles, 3 * hit.triangle + 2).xyz - a));
    vec4 places[3] = vec4[](ray_texel(ray_vertices, 2 * corners.x), ray_texel(ray_vertices, 2 * corners.y), ray_texel(ray_vertices, 2 * corners.z));
    vec4 colours[3] =
        vec4[](ray_texel(ray_vertices, 2 * corners.x + 1), ray_texel(ray_vertices, 2 * corners.y + 1), ray_texel(ray_vertices, 2 * corners.z + 1));
    int mesh = int(colours[0].w + 0.5);
    vec3 own = colours[0].rgb * (1.0 - hit.at.x - hit.at.y) + colours[1].rgb * hit.at.x + colours[2].rgb * hit.at.y;
    vec4 colour = ray_texel(ray_meshes, 5 * mesh), reflects = ray_texel(ray_meshes, 5 * mesh + 1);
    vec3 emission = ray_texel(ray_meshes, 5 * mesh + 2).rgb;
    colour.rgb *= own * reflecting_texel(mesh, 3, mixed(places[0].xy, places[1].xy, places[2].xy, hit.at)).rgb;
    emission *= reflecting_texel(mesh, 4, mixed(places[0].zw, places[1].zw, places[2].zw, hit.at)).rgb;
    float metallic = colour.w, flags = reflects.w;
    vec3 reflectance = reflects.rgb * (1.0 - metallic) + metallic * colour.rgb;
    vec3 albedo = min(reflectance + (1.0 - reflectance) * (1.0 - metallic) * colour.rgb, 1.0);  // reflecting.py
    if (mod(flags, 2.0) >= FLAG_UNLIT) emission *= own;
    if (mod(flags, 4.0) >= FLAG_CATCHER) albedo = ground;
    return Found(dot(normal, direction) > 0.0 ? -normal : normal, albedo, emission);
}
