// Where the prefiltered map has a direction: an octahedron map (normals.glsl) with a border, an eighth of its side, that repeats what lies
// beyond each edge, so that filtered lookups see no seam; after normals.glsl.

const float BORDER = 0.125;  // of the side: a texel of the coarsest level, of 8 texels

// Coordinates of the octahedron, beyond -1 and 1 in the border, at a place in a level of `side` texels; and back, for a direction of any length.
vec2 octahedron_of_texel(vec2 place, float side) { return (place / side * 2.0 - 1.0) / (1.0 - 2.0 * BORDER); }
vec2 prefiltered_uv(vec3 d) { return 0.5 + 0.5 * (1.0 - 2.0 * BORDER) * octahedron_from_direction(d); }

// The same point of the sphere with coordinates in -1 to 1: across an edge the octahedron goes on upside down.
vec2 unfolded(vec2 p) {
    if (abs(p.x) > 1.0) p = vec2(sign(p.x) * 2.0 - p.x, -p.y);
    if (abs(p.y) > 1.0) p = vec2(-p.x, sign(p.y) * 2.0 - p.y);
    return p;
}
