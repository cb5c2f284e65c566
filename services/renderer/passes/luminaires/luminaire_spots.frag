#version 430
// The shift-invariant approximation (Granier et al. 2003, equation 14): each basis function is a textured spot light, all in one pass.
// `images` holds E'; a summed-area table per channel gives its mean over what the point sees through the support, without samples.
#include "constants.glsl"
#include "normals.glsl"
#include "surface_texels.glsl"
#include "gbuffer.glsl"
#include "shadow_view.glsl"
#include "cube_faces.glsl"
#include "luminaire_maps.glsl"
#include "brdf.glsl"
#include "luminaire_surface.glsl"
#include "luminaire_field.glsl"

uniform sampler2DArray colour_sums;  // E' summed over pixels below and left
uniform vec3 scale;
layout(location = 0) out vec4 radiance;

vec3 colour_sum_at(float x, float y, int m, ivec2 size) {
    int i = min(int(x), size.x - 1), j = min(int(y), size.y - 1);
    float f = x - float(i), g = y - float(j);
    vec3 low = mix(texelFetch(colour_sums, ivec3(i, j, m), 0).rgb, texelFetch(colour_sums, ivec3(i + 1, j, m), 0).rgb, f);
    vec3 high = mix(texelFetch(colour_sums, ivec3(i, j + 1, m), 0).rgb, texelFetch(colour_sums, ivec3(i + 1, j + 1, m), 0).rgb, f);
    return mix(low, high, g);
}

// Mean colour over the box, from the pixels themselves where it lies within two columns and rows.
vec3 mean_colour(AxisBox u, AxisBox v, int m, ivec2 size) {
    PixelPair i = pixel_pair(u.x0, u.x1, size.x), j = pixel_pair(v.x0, v.x1, size.y);
    if (i.last - i.first <= 1 && j.last - j.first <= 1) {
        vec3 low = mix(texelFetch(images, ivec3(i.last, j.first, m), 0).rgb, texelFetch(images, ivec3(i.first, j.first, m), 0).rgb, i.weight);
        vec3 high = mix(texelFetch(images, ivec3(i.last, j.last, m), 0).rgb, texelFetch(images, ivec3(i.first, j.last, m), 0).rgb, i.weight);
        return mix(high, low, j.weight);
    }
    if (u.x1 <= u.x0 || v.x1 <= v.x0) return vec3(0.0);
    vec3 right = colour_sum_at(u.x1, v.x1, m, size) - colour_sum_at(u.x1, v.x0, m, size);
    vec3 left = colour_sum_at(u.x0, v.x1, m, size) - colour_sum_at(u.x0, v.x0, m, size);
    return (right - left) / ((u.x1 - u.x0) * (v.x1 - v.x0));
}

// Mean visibility of the cells of a basis function, each weighted by the integral of the function over it.
float spot_visibility(int m, Surface surface) {
    float visibility = 0.0;
    for (int b = 0; b < SUPPORT_CELLS; ++b) for (int a = 0; a < SUPPORT_CELLS; ++a) {
#if SUPPORT_CELLS == 2
        float weight = 0.25;
#else
        float weight = (a == 1 ? 4.0 : 1.0) * (b == 1 ? 4.0 : 1.0) / 36.0;
#endif
        visibility += weight * cell_visibility(ivec2(m % grid.x + a, m / grid.x + b), surface);
    }
    return visibility;
}

void main() {
    Surface surface;
    if (!surface_at(ivec2(gl_FragCoord.xy), surface) || surface.position.z <= 0.0) discard;
    ivec2 size = textureSize(images, 0).xy;
    clear_cell_visibilities();
    vec3 sum = vec3(0.0);
    for (int m = 0; m < grid.x * grid.y; ++m) {
        AxisBox u, v;
        vec2 centre;
        if (!image_boxes(m, surface.position, size, u, v, centre)) continue;
        vec3 d = vec3(centre, 0.0) - surface.position;
        float r = length(d);
        vec3 value = reflected(surface, d / r);
        if (value == vec3(0.0)) continue;
        float inside = abs((u.u1 - u.u0) * (v.u1 - v.u0)) / (SUPPORT * SUPPORT * spacing * spacing);  // what is clipped away is dark
        vec3 light = mean_colour(u, v, m, size) * inside;
        if (light == vec3(0.0)) continue;
        sum += light * value * (spacing * spacing * surface.position.z / (r * r * r) * spot_visibility(m, surface));
    }
    radiance = vec4(max(sum, 0.0) * scale, 0.0);
}
