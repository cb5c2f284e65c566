// Which share of a light reaches a surface, looked up in the light's shadow map; after light.glsl and lights.glsl.

uniform sampler2D atlas;

const float STEEPEST = 0.03;  // cosine at which the plane's slope is held; a light so low gives 3 % of its power at most
const float LIFTED = 3.0;  // times the bias at most, where light grazes: a caster may depart from its surface by the bias along the normal

// Share of light i that reaches a point of a surface with cosine dot(flat_normal, direction): the four nearest texels compared with the
// surface's own plane there, weighted bilinearly (percentage-closer filtering with plane bias, Isidoro 2006).
float visibility(int i, vec4 position, vec3 flat_normal, float cosine) {
    vec2 at = vec2(dot(lights[i].column, position), dot(lights[i].row, position)) - 0.5;
    at = clamp(at, vec2(0.5), vec2(lights[i].tile.z - 1.5));  // what lies beyond the map finds its empty rim
    vec2 slope = vec2(dot(lights[i].column.xyz, flat_normal), dot(lights[i].row.xyz, flat_normal));
    float steep = 1.0 / max(cosine, STEEPEST);
    slope *= lights[i].slope.xy * steep;
    vec2 f = fract(at);
    vec4 stored = textureGather(atlas, (lights[i].tile.xy + (at - f) + 1.0) * atlas_texel);
    float low = dot(lights[i].depth, position) - dot(slope, f) - min(steep, LIFTED) * lights[i].direction.w;
    vec4 own = min(low + vec4(slope.y, slope.x + slope.y, slope.x, 0.0), 1.0);
    vec4 lit = vec4(lessThanEqual(own, stored));
    vec2 side = mix(lit.wx, lit.zy, f.x);
    return mix(side.x, side.y, f.y);
}
