#version 430
// Sums a row of lights for each surface of a class: Lambert and, where GLOSSY is 1, normalised Phong; each light with its shadow map.

layout(early_fragment_tests) in;
#include "light.glsl"
#include "lights.glsl"
#include "normals.glsl"

const float PI = 3.14159265358979;

#if GLOSSY
uniform vec3 eye;
uniform sampler2D surface_specular;
#endif
uniform int light_count;
uniform float weight;  // of this pass in the picture: 1 / samples
uniform sampler2D surface_positions;
uniform sampler2D surface_normals;
uniform sampler2D surface_diffuse;
uniform sampler2D atlas;
layout(location = 0) out vec4 radiance;

const float STEEPEST = 0.03;  // cosine at which the plane's slope is held; a light so low gives 3 % of its power at most

// Share of light i that reaches a point of a surface with cosine dot(flat_normal, direction): the four nearest texels compared with the
// surface's own plane there, weighted bilinearly (percentage-closer filtering with plane bias, Isidoro 2006).
float visibility(int i, vec4 position, vec3 flat_normal, float cosine) {
    vec2 at = vec2(dot(lights[i].column, position), dot(lights[i].row, position));
    vec2 slope = vec2(dot(lights[i].column.xyz, flat_normal), dot(lights[i].row.xyz, flat_normal));
    slope *= lights[i].corner_slope.zw / max(cosine, STEEPEST);
    vec2 corner = floor(at - 0.5);
    vec2 f = at - 0.5 - corner;
    vec4 stored = textureGather(atlas, (lights[i].corner_slope.xy + corner + 1.0) / (tile_size * tile_columns));
    float low = dot(lights[i].depth, position) - dot(slope, f) - lights[i].direction.w;
    vec4 own = low + vec4(slope.y, slope.x + slope.y, slope.x, 0.0);
    vec4 lit = vec4(lessThanEqual(min(own, 1.0), stored));
    vec2 side = mix(lit.wx, lit.zy, f.x);
    vec2 inside = step(abs(at - 0.5 * tile_size), vec2(0.5 * tile_size - 1.0));
    return mix(1.0, mix(side.x, side.y, f.y), inside.x * inside.y);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = texelFetch(surface_positions, pixel, 0);
    vec4 normals = texelFetch(surface_normals, pixel, 0);
    vec3 smooth_normal = direction_from_octahedron(normals.xy);
    vec3 flat_normal = direction_from_octahedron(normals.zw);
    vec3 lambert = texelFetch(surface_diffuse, pixel, 0).rgb / PI;
#if GLOSSY
    vec3 mirrored_view = reflect(normalize(position.xyz - eye), smooth_normal);
    vec4 specular = texelFetch(surface_specular, pixel, 0);
    vec3 phong = specular.rgb * (specular.w + 2.0) / (2.0 * PI);
#endif

    vec3 sum = vec3(0.0);
    for (int i = 0; i < light_count; ++i) {
        vec3 d = lights[i].direction.xyz;
        float flat_cosine = dot(flat_normal, d);
        float cosine = flat_cosine > 0.0 ? max(dot(smooth_normal, d), 0.0) : 0.0;
        vec3 brdf = lambert;
#if GLOSSY
        brdf += phong * pow(max(dot(mirrored_view, d), 1e-6), specular.w);
#endif
        sum += lights[i].irradiance.rgb * brdf * (cosine * visibility(i, position, flat_normal, flat_cosine));
    }
    radiance = vec4(sum, 0.0) * weight;
}
