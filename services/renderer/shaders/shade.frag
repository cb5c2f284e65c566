#version 430
// Sums the lights of a batch for each visible surface: Lambert and normalised Phong, each light with its shadow map.
#include "light.glsl"
#include "normals.glsl"

const float PI = 3.14159265358979;

uniform vec3 eye;
uniform int light_count;
uniform float weight;  // of this pass in the picture: 1 / samples
uniform float first_batch;  // 1 in the first batch of lights, which brings the alpha; else 0
uniform sampler2D surface_positions;
uniform sampler2D surface_normals;
uniform sampler2D surface_diffuse;
uniform sampler2D surface_specular;
uniform sampler2D atlas;
layout(location = 0) out vec4 radiance;

const float BIAS = 1.0;  // texels: what a surface may rise above its tangent plane within a texel
const float STEEPEST = 0.03;  // cosine at which the plane's slope is held; a light so low gives 3 % of its power at most

// Share of a light that reaches a point: the four nearest texels compared with the receiver's plane there, weighted bilinearly
// (percentage-closer filtering with plane bias, Isidoro 2006).
float visibility(vec3 position, vec3 flat_normal, vec3 d, float tile, int box) {
    LightFrame frame = light_frame(d, box_half[box]);
    vec3 at = tile_from_box(position - box_centre[box], d, frame);
    if (any(lessThan(at.xy, vec2(1.0))) || any(greaterThan(at.xy, vec2(tile_size - 1.0)))) return 1.0;
    vec2 texel = frame.extent.xy / (0.5 * tile_size - GUTTER);
    float depth = 0.5 * DEEPEST / frame.extent.z;  // of a metre
    vec2 slope = vec2(dot(frame.right, flat_normal), dot(frame.up, flat_normal)) * texel * (depth / max(dot(flat_normal, d), STEEPEST));
    vec2 corner = floor(at.xy - 0.5);
    vec2 f = at.xy - 0.5 - corner;
    vec4 stored = textureGather(atlas, (tile_corner(tile) + corner + 1.0) / (tile_size * tile_columns));
    float low = at.z - dot(slope, f) - BIAS * depth * max(texel.x, texel.y);
    vec4 own = low + vec4(slope.y, slope.x + slope.y, slope.x, 0.0);
    vec4 lit = vec4(lessThanEqual(min(own, 1.0), stored));
    vec2 side = mix(lit.wx, lit.zy, f.x);
    return mix(side.x, side.y, f.y);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = texelFetch(surface_positions, pixel, 0);
    if (position.w == 0.0) discard;
    vec4 normals = texelFetch(surface_normals, pixel, 0);
    vec3 smooth_normal = direction_from_octahedron(normals.xy);
    vec3 flat_normal = direction_from_octahedron(normals.zw);
    vec3 mirrored_view = reflect(normalize(position.xyz - eye), smooth_normal);
    vec3 lambert = texelFetch(surface_diffuse, pixel, 0).rgb / PI;
    vec4 specular = texelFetch(surface_specular, pixel, 0);
    vec3 phong = specular.rgb * (specular.w + 2.0) / (2.0 * PI);
    bool glossy = any(greaterThan(phong, vec3(0.0)));

    vec3 sum = vec3(0.0);
    for (int i = 0; i < light_count; ++i) {
        vec4 light = lights[2 * i];
        float cosine = dot(smooth_normal, light.xyz);
        if (cosine <= 0.0 || dot(flat_normal, light.xyz) <= 0.0) continue;
        vec4 irradiance = lights[2 * i + 1];
        float seen = visibility(position.xyz, flat_normal, light.xyz, light.w, int(irradiance.w));
        if (seen == 0.0) continue;
        vec3 brdf = lambert;
        if (glossy) brdf += phong * pow(max(dot(mirrored_view, light.xyz), 0.0), specular.w);
        sum += irradiance.rgb * brdf * (cosine * seen);
    }
    radiance = vec4(sum, first_batch) * weight;
}
