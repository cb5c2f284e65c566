// Perspective shadow maps through the faces of a cube, with any window of tangents. Depth is linear in 1 / z, and so is a plane: receivers are
// compared with their own plane.

const float MAP_BIAS = 0.5;  // texels: what a surface may rise above its tangent plane within a texel
const float MIN_COSINE = 0.03;  // a receiver at a flatter angle is treated as facing the map

// The four texels about the corner between them, in the order of textureGather.
vec4 gathered_texels(sampler2D maps, vec2 corner, vec2 texture_size) {
#ifdef GL_ES
    ivec2 last = ivec2(corner);
    vec2 above = vec2(texelFetch(maps, last - ivec2(1, 0), 0).r, texelFetch(maps, last, 0).r);
    return vec4(above, texelFetch(maps, last - ivec2(0, 1), 0).r, texelFetch(maps, last - 1, 0).r);
#else
    return textureGather(maps, corner / texture_size);
#endif
}

// A vector as the view through a face sees it, depth in z.
vec3 through_face(vec3 v, float number) {
    int face = int(number);
    vec3 turned = face < 2 ? v : face < 4 ? v.yzx : v.zxy;
    return (face & 1) == 1 ? vec3(turned.xy, -turned.z) : turned;
}

// The face of a cube through which a vector goes.
int face_of(vec3 v) {
    vec3 a = abs(v);
    int axis = a.z >= a.x && a.z >= a.y ? 0 : a.x >= a.y ? 2 : 4;
    float along = axis == 0 ? v.z : axis == 2 ? v.x : v.y;
    return axis + (along < 0.0 ? 1 : 0);
}

// Fraction of a light that reaches a place q on a surface of flat normal n, both as the view sees them: bilinear over the four texels around it, each
// compared with the receiver's own plane at that texel; 1 outside the map. low, high: its window of tangents. corner, size: its first texel and its texels
// a side, in a texture of so many. inverse_depths: 1 / near and 1 / far.
float lit_by_own_plane(sampler2D maps, vec2 texture_size, vec2 corner, float size, vec2 low, vec2 high, vec2 inverse_depths, vec3 q, vec3 n) {
    if (q.z * inverse_depths.x <= 1.0) return 1.0;
    vec2 texel = (high - low) / size;
    vec2 at = (q.xy / q.z - low) / texel;
    if (any(lessThan(at, vec2(1.0))) || any(greaterThan(at, vec2(size - 1.0)))) return 1.0;
    vec2 first = floor(at - 0.5);
    vec2 f = at - 0.5 - first;
    vec4 stored = gathered_texels(maps, corner + first + 1.0, texture_size);
    float height = dot(n, q);
    bool grazing = abs(height) < MIN_COSINE * length(q);
    vec2 tangent = low + (first + 0.5) * texel;
    vec4 inverse;
    for (int k = 0; k < 4; ++k) {
        vec2 side = vec2(k == 1 || k == 2 ? 1.0 : 0.0, k < 2 ? 1.0 : 0.0);  // the order of textureGather
        inverse[k] = grazing ? 1.0 / q.z : dot(n, vec3(tangent + side * texel, 1.0)) / height;
    }
    inverse *= 1.0 + MAP_BIAS * max(texel.x, texel.y);
    vec4 own = (inverse_depths.x - inverse) / (inverse_depths.x - inverse_depths.y);
    vec4 lit = vec4(lessThanEqual(min(own, 1.0), stored));
    vec2 side = mix(lit.wx, lit.zy, f.x);
    return mix(side.x, side.y, f.y);
}
