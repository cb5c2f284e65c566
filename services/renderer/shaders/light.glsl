// A batch of directional lights, and where the shadow map of each lies: an orthographic view along the light, fitted to the box around
// all that casts its shadow and rebuilt here from the light's direction alone.

layout(std140) uniform Lights {
    vec4 lights[2 * MAX_LIGHTS];  // direction and tile; irradiance (RGB) and caster box
};

uniform vec3 box_centre[2];  // casters of lights above the floor, and of lights below it
uniform vec3 box_half[2];

struct LightFrame { vec3 right, up, extent; };

// Duff et al. 2017, Building an Orthonormal Basis, Revisited; the branch is on z < 0. Extents never are 0, so that a flat box keeps a map.
LightFrame light_frame(vec3 d, vec3 half_size) {
    float s = d.z < 0.0 ? -1.0 : 1.0;
    float a = -1.0 / (s + d.z);
    float b = d.x * d.y * a;
    vec3 right = vec3(1.0 + s * d.x * d.x * a, s * b, -s * d.x);
    vec3 up = vec3(b, s + d.y * d.y * a, -d.y);
    vec3 extent = vec3(dot(abs(right), half_size), dot(abs(up), half_size), dot(abs(d), half_size));
    return LightFrame(right, up, extent + 1e-4 * dot(half_size, vec3(1.0)));
}

const float GUTTER = 2.0;  // texels at a tile's rim that stay empty, so that a filtered lookup sees no neighbour
const float DEEPEST = 0.99;  // casters end here, so that only an empty texel holds 1

uniform float tile_size;  // texels on a side
uniform float tile_columns;  // the atlas is a square of so many tiles a side

vec2 tile_corner(float tile) {
    float row = floor((tile + 0.5) / tile_columns);
    return vec2(tile - row * tile_columns, row) * tile_size;
}

// Texel coordinates in the light's tile and depth in [0, DEEPEST] of a point of the caster box, relative to the box's centre.
vec3 tile_from_box(vec3 p, vec3 d, LightFrame frame) {
    vec2 inside = vec2(dot(frame.right, p), dot(frame.up, p)) / frame.extent.xy;
    return vec3(0.5 * tile_size + inside * (0.5 * tile_size - GUTTER), (0.5 - 0.5 * dot(d, p) / frame.extent.z) * DEEPEST);
}
