// A texel of a level of the prefiltered map: the environment map on an octahedron, each level blurred to twice the width of the one before. LEVEL_0:
// made of the polar map; else of the level before. After constants.glsl, normals.glsl and octahedral_map.glsl.

uniform sampler2D source;  // the polar map or the prefiltered map
uniform float lowest;  // height, -1 to 1, below which the level is black

#if LEVEL_0
uniform float span;  // of theta: pi / 2 or pi

const float TURN = 6.28318530717959;
const float WHOLE_SPHERE = 3.0;  // a span beyond it is pi; any value in pi / 2 to pi does

// Bilinear between the cells, as the background shows them.
vec3 filtered(vec3 d) {
    float theta = atan(length(d.xy), d.z);
    if (theta >= span && span < WHOLE_SPHERE) return vec3(0.0);
    return textureLod(source, vec2(atan(d.y, d.x) / TURN, theta / span), 0.0).rgb;
}
#else
uniform float before;  // the level of the source that is read
uniform float spacing;  // of the taps, the middle of a hexagon and its corners: the tangent of the angle between two of them

vec3 filtered(vec3 d) {
    vec3 right = normalize(abs(d.z) < 0.7 ? vec3(-d.y, d.x, 0.0) : vec3(0.0, -d.z, d.y)), up = cross(d, right);
    right *= spacing;
    up *= spacing;
    vec3 half_right = 0.5 * right, high = 0.8660254 * up;
    vec3 sum = textureLod(source, prefiltered_uv(d), before).rgb;
    sum += textureLod(source, prefiltered_uv(d + right), before).rgb + textureLod(source, prefiltered_uv(d - right), before).rgb;
    sum += textureLod(source, prefiltered_uv(d + half_right + high), before).rgb;
    sum += textureLod(source, prefiltered_uv(d - half_right + high), before).rgb;
    sum += textureLod(source, prefiltered_uv(d + half_right - high), before).rgb;
    sum += textureLod(source, prefiltered_uv(d - half_right - high), before).rgb;
    return sum / 7.0;
}
#endif

// The texel in whose middle `place` is, of a level of `side` texels.
vec3 prefiltered_texel(vec2 place, float side) {
    vec2 p = octahedron_of_texel(place, side);
    if (any(greaterThan(abs(p), vec2(1.0 + 4.0 / side)))) return vec3(0.0);  // no lookup reads it
    vec3 d = direction_from_octahedron(unfolded(p));
    return d.z < lowest ? vec3(0.0) : filtered(d);
}
