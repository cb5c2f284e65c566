// Shadow maps of a luminaire in one depth texture, a grid of tiles: a perspective view from each reference position, towards one of the
// six faces of a cube, with any window of tangents. Depth is linear in 1 / z, and so is a plane: receivers are compared with their own plane.

layout(std140) uniform Maps {
    vec4 maps[2 * MAX_MAPS];  // reference position and face; window of tangents: low x, low y, high x, high y
};

uniform float map_size;  // texels of a tile's side
uniform float map_columns;  // the texture is a square of so many tiles a side
uniform vec2 map_range;  // 1 / near and 1 / far

vec3 facing(vec3 v, int face) {
    vec3 turned = face < 2 ? v : face < 4 ? v.yzx : v.zxy;
    return (face & 1) == 1 ? vec3(turned.xy, -turned.z) : turned;
}

vec2 map_corner(int index) {
    float row = floor((float(index) + 0.5) / map_columns);
    return vec2(float(index) - row * map_columns, row);
}
