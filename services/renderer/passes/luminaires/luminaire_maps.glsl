// Shadow maps of a luminaire in one depth texture, a grid of tiles: a view of cube_faces.glsl from each reference position.

layout(std140) uniform ShadowViews { ShadowView views[MAX_MAPS]; };

uniform float map_size;  // texels of a tile's side
uniform float map_columns;  // the texture is a square of so many tiles a side
uniform vec2 inverse_depths;  // 1 / near and 1 / far

// A map's column and row in the grid of tiles.
vec2 map_corner(int index) {
    float row = floor((float(index) + 0.5) / map_columns);
    return vec2(float(index) - row * map_columns, row);
}
