#version 430
// Sums a row of lights for each surface of a class: KIND 0 is Lambert, 1 adds
// normalised Phong, 2 is GGX as glTF has it; 3 catches shadows: its alpha is the share of
// light that they take. Each light with its shadow map.

layout(early_fragment_tests) in;
#include "light.glsl"
#include "lights.glsl"
#include "normals.glsl"

const float PI = 3.14159265358979;

#if KIND == 3
uniform float unshadowed;  // luminance of what the lights give to a catcher without shadows
#elif KIND > 0
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

#if KIND == 2
// glTF 2.0, appendix B.3: Trowbridge-Reitz with the height-correlated Smith term and Schlick's Fresnel term.
vec3 ggx(vec3 lambert, vec3 f0, float alpha, vec3 normal, vec3 view, float view_cosine, vec3 d, float cosine) {
    vec3 halfway = normalize(view + d);
    float n = clamp(dot(normal, halfway), 0.0, 1.0);
    float a2 = alpha * alpha;
    float t = n * n * (a2 - 1.0) + 1.0;
    float visible = 0.5 / (cosine * sqrt(view_cosine * view_cosine * (1.0 - a2) + a2) + view_cosine * sqrt(cosine * cosine * (1.0 - a2) + a2));
    float grazing = 1.0 - clamp(dot(view, halfway), 0.0, 1.0);
    vec3 fresnel = f0 + (1.0 - f0) * (grazing * grazing) * (grazing * grazing) * grazing;
    return lambert * (1.0 - fresnel) + fresnel * (a2 / (PI * t * t) * visible);
}
#endif

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = texelFetch(surface_positions, pixel, 0);
    vec4 normals = texelFetch(surface_normals, pixel, 0);
    vec3 smooth_normal = direction_from_octahedron(normals.xy);
    vec3 flat_normal = direction_from_octahedron(normals.zw);
#if KIND < 3
    vec3 lambert = texelFetch(surface_diffuse, pixel, 0).rgb / PI;
#endif
#if KIND == 1 || KIND == 2
    vec3 view = normalize(eye - position.xyz);
    vec4 specular = texelFetch(surface_specular, pixel, 0);
#endif
#if KIND == 1
    vec3 mirrored_view = reflect(-view, smooth_normal);
    vec3 phong = specular.rgb * (specular.w + 2.0) / (2.0 * PI);
#elif KIND == 2
    float view_cosine = max(dot(smooth_normal, view), 1e-4);
#endif

    vec3 sum = vec3(0.0);
    float taken = 0.0;
    for (int i = 0; i < light_count; ++i) {
        vec3 d = lights[i].direction.xyz;
        float flat_cosine = dot(flat_normal, d);
        float cosine = flat_cosine > 0.0 ? max(dot(smooth_normal, d), 0.0) : 0.0;
#if KIND == 3
        taken += dot(lights[i].irradiance.rgb, vec3(0.2126, 0.7152, 0.0722)) * cosine * (1.0 - visibility(i, position, flat_normal, flat_cosine));
#else
#if KIND == 0
        vec3 brdf = lambert;
#elif KIND == 1
        vec3 brdf = lambert + phong * pow(max(dot(mirrored_view, d), 1e-6), specular.w);
#else
        vec3 brdf = ggx(lambert, specular.rgb, specular.w, smooth_normal, view, view_cosine, d, max(cosine, 1e-4));
#endif
        sum += lights[i].irradiance.rgb * brdf * (cosine * visibility(i, position, flat_normal, flat_cosine));
#endif
    }
#if KIND == 3
    taken /= unshadowed;
#endif
    radiance = vec4(sum, taken) * weight;
}
