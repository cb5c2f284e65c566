// Unit vectors as two numbers: the octahedron map (Meyer et al. 2010, On Floating-Point Normal Vectors), and those as 16-bit codes; after
// constants.glsl. The functions of normals.py.

vec2 octahedron_from_direction(vec3 d) {
    vec2 p = d.xy / (abs(d.x) + abs(d.y) + abs(d.z));
    return d.z >= 0.0 ? p : (1.0 - abs(p.yx)) * vec2(p.x >= 0.0 ? 1.0 : -1.0, p.y >= 0.0 ? 1.0 : -1.0);
}

vec3 direction_from_octahedron(vec2 p) {
    float z = 1.0 - abs(p.x) - abs(p.y);
    float fold = max(-z, 0.0);
    return normalize(vec3(p.x + (p.x >= 0.0 ? -fold : fold), p.y + (p.y >= 0.0 ? -fold : fold), z));
}

// What a texture of 16 bits a number stores, 0 to 1, of -1 to 1, such that 0 is exactly a code.
vec2 code_from_octahedron(vec2 p) { return (p * NORMAL_CODES + (NORMAL_CODES + 1.0)) / (2.0 * NORMAL_CODES + 1.0); }

vec2 octahedron_from_code(vec2 code) { return (code * (2.0 * NORMAL_CODES + 1.0) - (NORMAL_CODES + 1.0)) / NORMAL_CODES; }
