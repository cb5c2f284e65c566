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
uniform sampler2DShadow atlas;
layout(location = 0) out vec4 radiance;

// Share of a light that reaches a point: the four nearest texels compared, weighted bilinearly (percentage-closer filtering).
float visibility(vec3 position, vec3 flat_normal, vec3 d, float tile, int box) {
    LightFrame frame = light_frame(d, box_half[box]);
    // Texels compared lie up to sqrt(2) texels off, where a surface at this slope is sqrt(2) texel tan(angle) deeper; a step of
    // sqrt(2) texel sin(angle) along the normal gains just that depth. 1.5 for sqrt(2) leaves room for the depth's rounding.
    float texel = 2.0 * max(frame.extent.x, frame.extent.y) / (tile_size - 2.0 * GUTTER);
    float cosine = dot(flat_normal, d);
    vec3 p = position - box_centre[box] + flat_normal * (1.5 * texel * sqrt(max(1.0 - cosine * cosine, 0.0)) + 0.02 * texel);
    if (any(greaterThan(abs(vec2(dot(frame.right, p), dot(frame.up, p))), frame.extent.xy))) return 1.0;
    vec3 at = atlas_from_box(p, d, frame, tile);
    return texture(atlas, vec3(at.xy / (tile_size * tile_columns), clamp(at.z, 0.0, 1.0)));
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
