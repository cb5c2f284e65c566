// The lights of a batch and where the shadow map of each lies in the atlas.

const float GUTTER = 2.0;  // texels at a tile's rim that stay empty, so that a filtered lookup sees no neighbour
const float DEEPEST = 0.99;  // depth at which casters end, so that only an empty texel holds 1
const float BIAS = 1.0;  // texels: what a surface may rise above its tangent plane within a texel

struct LightFrame {
    vec4 column, row;  // texel in the light's tile = dot(xyz, world position) + w
    vec4 depth;  // likewise in [0, DEEPEST], growing away from the light
    vec4 direction;  // to the light; w: BIAS in depth
    vec4 irradiance;  // RGB on a plane that faces the light; w: number of the tile
    vec4 tile;  // its first texel; texels on a side
    vec4 slope;  // depth a texel of a plane with normal n: xy * dot(column or row, n) / dot(direction, n)
};

uniform vec2 atlas_texel;  // 1 / its sides in texels
