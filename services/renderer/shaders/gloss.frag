#version 430
// Adds what the many weak lights of the second set give to the lobes of glossy surfaces: those in the cone about the mirrored view, from
// the row of the region that it lies in. Each is shadowed by the map of the strong light nearest to it.

#include "light.glsl"
#include "lights.glsl"
#include "visibility.glsl"
#include "normals.glsl"
#include "seen.glsl"
#include "brdf.glsl"
#include "cone.glsl"

uniform float weight;  // of this pass in the picture: 1 / samples
uniform sampler2D surface_diffuse;
uniform sampler2D surface_specular;
uniform samplerCube region_of_direction;
uniform sampler2D spans;  // of each region: its first light, and how many
// Line after line, two texels a light: direction and number of its strong light; irradiance and the square of its spread, rad. A disc of
// that radius has a quarter of the square as variance along an axis. Phong's lobe has 1 / exponent, GGX' lobe of halfway vectors, which
// move half as far as the light, about alpha^2 / 2.
uniform sampler2D weak_lights;
layout(location = 0) out vec4 radiance;

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    vec4 position = seen_position();
    float kind = texelFetch(surface_diffuse, pixel, 0).w;
    if (position.w == 0.0 || kind < 0.5 || kind > 2.5) discard;
    vec4 specular = texelFetch(surface_specular, pixel, 0);
    bool phong = kind < 1.5;
    float narrow = phong ? narrow_phong(specular.w) : narrow_ggx(specular.w);
    if (narrow == 0.0) discard;
    vec4 normals = seen_normals();
    vec3 smooth_normal = direction_from_octahedron(normals.xy);
    vec3 flat_normal = direction_from_octahedron(normals.zw);
    vec3 mirrored_view = reflect(normalize(seen_ray()), smooth_normal);
    float view_cosine = max(dot(smooth_normal, mirrored_view), 1e-4);
    int region = int(textureLod(region_of_direction, mirrored_view, 0.0).r);
    ivec2 span = ivec2(texelFetch(spans, ivec2(region, 0), 0).xy);
    int line = textureSize(weak_lights, 0).x / 2;

    vec3 sum = vec3(0.0);
    for (int k = span.x; k < span.x + span.y; ++k) {
        ivec2 place = ivec2(2 * (k % line), k / line);
        vec4 light = texelFetch(weak_lights, place, 0);
        float mirrored = dot(mirrored_view, light.xyz);
        float share = in_cone(mirrored);
        float cosine = dot(smooth_normal, light.xyz);
        if (share <= 0.0 || cosine <= 0.0 || dot(flat_normal, light.xyz) <= 0.0) continue;
        vec4 irradiance = texelFetch(weak_lights, place + ivec2(1, 0), 0);
        vec3 lobe;
        if (phong) {
            lobe = specular.rgb * phong_lobe(1.0 / (1.0 / max(specular.w, 1e-3) + 0.25 * irradiance.w), mirrored);
        } else {
            vec2 facets = ggx_lobe(sqrt(specular.w * specular.w + 0.125 * irradiance.w), cosine, view_cosine, 2.0 * view_cosine * cosine - mirrored);
            lobe = mix(specular.rgb, vec3(1.0), facets.y) * facets.x;
        }
        int strong = int(light.w);
        float over = dot(flat_normal, lights[strong].direction.xyz);
        float seen = over > 0.0 ? visibility(strong, position, flat_normal, over) : 1.0;  // a map knows nothing of what it lies behind
        sum += irradiance.rgb * lobe * (share * cosine * seen);
    }
    radiance = vec4(sum * (narrow * weight), 0.0);
}
