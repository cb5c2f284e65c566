// Shadow maps of a luminaire in one depth texture, a grid of tiles: a perspective view from each reference position, through one of the
// six faces of a cube, with any window of tangents. Depth is linear in 1 / z, and so is a plane: receivers are compared with their own plane.

layout(std140) uniform ShadowViews { ShadowView views[MAX_MAPS]; };

uniform float map_size;  // texels of a tile's side
uniform float map_columns;  // the texture is a square of so many tiles a side
uniform vec2 inverse_depths;  // 1 / near and 1 / far

// A vector as the view through a face sees it, depth in z.
vec3 through_face(vec3 v, float number) {
    int face = int(number);
    vec3 turned = face < 2 ? v : face < 4 ? v.yzx : v.zxy;
    return (face & 1) == 1 ? vec3(turned.xy, -turned.z) : turned;
}

// A map's column and row in the grid of tiles.
vec2 map_corner(int index) {
    float row = floor((float(index) + 0.5) / map_columns);
    return vec2(float(index) - row * map_columns, row);
}
