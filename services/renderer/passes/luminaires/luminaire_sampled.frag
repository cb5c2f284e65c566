#version 430
// Position-dependent importance sampling of a light field (Lu et al. 2015): estimator.py, in GLSL.
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

uniform sampler2D sequence;  // Halton points, one texel each
uniform sampler2D shifts;  // of the sequence and of the rounding, a tile of pixels
uniform int samples;
uniform int max_per_image;  // samples of one image
uniform vec3 scale;  // the luminaire's power times the weight of this pass
layout(location = 0) out vec4 radiance;

// The pixel that uniform numbers ab choose, and the place in the box, from 0 to 1 across it. ends: the sums of the box's marginal at u.x0, u.x1.
ivec2 sample_box(AxisBox u, AxisBox v, int m, ivec2 size, dvec2 ends, vec2 ab, out vec2 place) {
    PixelPair i = pixel_pair(u.x0, u.x1, size.x), j = pixel_pair(v.x0, v.x1, size.y);
    if (i.last - i.first <= 1 && j.last - j.first <= 1) {
        float q00 = importance(ivec3(i.first, j.first, m)), q10 = importance(ivec3(i.last, j.first, m));
        float q01 = importance(ivec3(i.first, j.last, m)), q11 = importance(ivec3(i.last, j.last, m));
        float left = i.weight * mix(q01, q00, j.weight), right = (1.0 - i.weight) * mix(q11, q10, j.weight);
        float target = ab.x * (left + right);
        bool first = target < left || right <= 0.0;
        place.x = first ? i.weight * target / left : i.weight + (1.0 - i.weight) * min((target - left) / right, 1.0);
        float low = j.weight * (first ? q00 : q10), high = (1.0 - j.weight) * (first ? q01 : q11);
        target = ab.y * (low + high);
        bool below = target < low || high <= 0.0;
        place.y = below ? j.weight * target / low : j.weight + (1.0 - j.weight) * min((target - low) / high, 1.0);
        return ivec2(first ? i.first : i.last, below ? j.first : j.last);
    }
    // binary search in the box's marginal, a strip at a time
    double at_left = ends.x, at_right = ends.y;
    double target = at_left + ab.x * (at_right - at_left);
    int column = i.first, end = i.last + 1;
    while (end - column > 1) {
        int middle = (column + end) / 2;
        double marginal = strip(float(middle), v.x0, v.x1, m, size);
        if (marginal <= target) { column = middle; at_left = marginal; } else { end = middle; at_right = marginal; }
    }
    float left = max(float(column), u.x0), right = min(float(column + 1), u.x1), width = float(at_right - at_left);
    float x = left + (right - left) * (width > 0.0 ? clamp(float(target - at_left) / width, 0.0, 1.0) : 0.5);
    double below = column_at(column, v.x0, m, size), above = column_at(column, v.x1, m, size);
    target = below + ab.y * (above - below);
    int row = j.first;
    end = j.last + 1;
    while (end - row > 1) {
        int middle = (row + end) / 2;
        double conditional = sum_at(column + 1, middle, m) - sum_at(column, middle, m);
        if (conditional <= target) { row = middle; below = conditional; } else { end = middle; above = conditional; }
    }
    float bottom = max(float(row), v.x0), top = min(float(row + 1), v.x1), height = float(above - below);
    float y = bottom + (top - bottom) * (height > 0.0 ? clamp(float(target - below) / height, 0.0, 1.0) : 0.5);
    place = vec2((x - u.x0) / (u.x1 - u.x0), (y - v.x0) / (v.x1 - v.x0));
    return ivec2(column, row);
}

// Visibility of the cell that a sample leaves through.
float sample_visibility(vec2 u, Surface surface) {
    ivec2 cell = ivec2(floor((u - first_m) / spacing + 0.5 * SUPPORT));
    return cell_visibility(clamp(cell, ivec2(0), grid + SUPPORT_CELLS - 2), surface);
}

void main() {
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    Surface surface;
    if (!surface_at(pixel, surface) || surface.position.z <= 0.0) discard;
    vec3 p = surface.position;
    ivec2 size = textureSize(images, 0).xy;
    float total = 0.0;
    float weights[IMAGES];
    for (int m = 0; m < IMAGES; ++m) total += weights[m] = image_weight(m, p, size);
    if (total <= 0.0) discard;
    clear_cell_visibilities();
    vec3 shift = texelFetch(shifts, pixel % textureSize(shifts, 0), 0).xyz;
    float ratio = plane_distance / (p.z * spacing);
    float passed = 0.0;
    int drawn = 0;
    vec3 sum = vec3(0.0);
    for (int m = 0; m < IMAGES; ++m) {
        float expected = float(samples) * (weights[m] / total);
        int number = int(floor(passed + expected + shift.z)) - int(floor(passed + shift.z));
        passed += expected;
        float divisor = expected;
        if (expected > float(max_per_image)) { number = max_per_image; divisor = float(max_per_image); }
        if (number <= 0) continue;
        AxisBox u, v;
        vec2 centre;
        image_boxes(m, p, size, u, v, centre);
        dvec2 ends = dvec2(strip(u.x0, v.x0, v.x1, m, size), strip(u.x1, v.x0, v.x1, m, size));
        float weight = ratio * ratio * weights[m] / divisor;
        for (int k = 0; k < number; ++k, ++drawn) {
            vec2 ab = fract(texelFetch(sequence, ivec2(drawn, 0), 0).xy + shift.xy);
            vec2 in_box;
            ivec2 at = sample_box(u, v, m, size, ends, ab, in_box);
            vec3 colour = texelFetch(images, ivec3(at, m), 0).rgb;
            float q = dot(abs(colour), LUMINANCE_WEIGHTS);
            if (q <= 0.0) continue;
            vec2 on_u = vec2(mix(u.u0, u.u1, in_box.x), mix(v.u0, v.u1, in_box.y));
            vec2 x = (on_u - centre) / spacing;
            vec3 d = vec3(on_u, 0.0) - p;
            float r = length(d);
            vec3 value = reflected(surface, d / r);
            if (value == vec3(0.0)) continue;
            sum += colour * value * (weight * basis(x.x) * basis(x.y) * (r / p.z) / q * sample_visibility(on_u, surface));
        }
    }
    radiance = vec4(max(sum, 0.0) * scale, 0.0);
}
