// What of a light arrives at a surface, looked up in the light's shadow map; after lights.glsl.

uniform sampler2D atlas;

const float MIN_SLOPE_COSINE = 0.03;  // the receiver's slope grows no further towards grazing light, which gives 3 % of its power at most there
// Times the bias at most, where light grazes: a caster may depart from the true surface by the bias along the normal, which is
// bias / cosine along the light. Beyond 3, lit gaps under what stands on a ground show more than the shadows that are missed.
const float MAX_NORMAL_BIAS = 3.0;

#ifdef GL_ES
vec4 gathered(vec2 at) {
    ivec2 texel = ivec2(floor(at / atlas_texel - 0.5));
    vec2 above = vec2(texelFetch(atlas, texel + ivec2(0, 1), 0).r, texelFetch(atlas, texel + ivec2(1, 1), 0).r);
    return vec4(above, texelFetch(atlas, texel + ivec2(1, 0), 0).r, texelFetch(atlas, texel, 0).r);
}
#else
vec4 gathered(vec2 at) { return textureGather(atlas, at); }
#endif

// Fraction of light i that arrives at a point of a surface, where cosine = dot(flat_normal, direction): the four nearest texels, each compared
// with the surface's own plane there, weighted bilinearly (percentage-closer filtering with receiver plane depth bias, Isidoro 2006).
float visibility(int i, vec4 position, vec3 flat_normal, float cosine) {
    vec2 at = vec2(dot(lights[i].column, position), dot(lights[i].row, position)) - 0.5;
    at = clamp(at, vec2(0.5), vec2(lights[i].resolution - 1.5));  // what lies beyond the map finds its empty rim
    vec2 slope = vec2(dot(lights[i].column.xyz, flat_normal), dot(lights[i].row.xyz, flat_normal));
    float steepness = 1.0 / max(cosine, MIN_SLOPE_COSINE);
    slope *= lights[i].slope * steepness;
    vec2 f = fract(at);
    vec4 stored = gathered((lights[i].corner + (at - f) + 1.0) * atlas_texel);
    float nearest = dot(lights[i].depth, position) - dot(slope, f) - min(steepness, MAX_NORMAL_BIAS) * lights[i].bias;
    vec4 own = min(nearest + vec4(slope.y, slope.x + slope.y, slope.x, 0.0), 1.0);
    vec4 lit = vec4(lessThanEqual(own, stored));
    vec2 side = mix(lit.wx, lit.zy, f.x);
    return mix(side.x, side.y, f.y);
}
