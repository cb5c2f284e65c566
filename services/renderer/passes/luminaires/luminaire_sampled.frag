#version 430
// Position-dependent importance sampling of a light field (Lu et al. 2015): estimator.py, in GLSL.
#include "normals.glsl"
#include "gbuffer.glsl"
#include "luminaire_maps.glsl"
#include "brdf.glsl"
#include "luminaire_surface.glsl"
#include "luminaire_field.glsl"

uniform sampler2D sequence;  // Halton points, one texel each
uniform sampler2D shifts;  // of the sequence and of the rounding, a tile of pixels
uniform int samples;
uniform int most;  // samples of one image
uniform vec3 scale;  // the lamp's power times the weight of this pass
layout(location = 0) out vec4 radiance;

// The pixel and the shares of the box at uniform numbers a and b; ends: the sums of the box's marginal at u.x0 and u.x1.
ivec2 sample_box(AxisBox u, AxisBox v, int m, ivec2 size, dvec2 ends, vec2 ab, out vec2 share) {
    Pair i = pair_of(u.x0, u.x1, size.x), j = pair_of(v.x0, v.x1, size.y);
    if (i.last - i.first <= 1 && j.last - j.first <= 1) {
        float q00 = importance(ivec3(i.first, j.first, m)), q10 = importance(ivec3(i.last, j.first, m));
        float q01 = importance(ivec3(i.first, j.last, m)), q11 = importance(ivec3(i.last, j.last, m));
        float left = i.share * mix(q01, q00, j.share), right = (1.0 - i.share) * mix(q11, q10, j.share);
        float target = ab.x * (left + right);
        bool first = target < left || right <= 0.0;
        share.x = first ? i.share * target / left : i.share + (1.0 - i.share) * min((target - left) / right, 1.0);
        float low = j.share * (first ? q00 : q10), high = (1.0 - j.share) * (first ? q01 : q11);
        target = ab.y * (low + high);
        bool below = target < low || high <= 0.0;
        share.y = below ? j.share * target / low : j.share + (1.0 - j.share) * min((target - low) / high, 1.0);
        return ivec2(first ? i.first : i.last, below ? j.first : j.last);
    }
    // the marginal of the box, a strip at a time; the search keeps the sums at its ends
    double at_left = ends.x, at_right = ends.y;
    double target = at_left + ab.x * (at_right - at_left);
    int column = i.first, end = i.last + 1;
    while (end - column > 1) {
        int middle = (column + end) / 2;
        double here = strip(float(middle), v.x0, v.x1, m, size);
        if (here <= target) { column = middle; at_left = here; } else { end = middle; at_right = here; }
    }
    float left = max(float(column), u.x0), right = min(float(column + 1), u.x1), width = float(at_right - at_left);
    float x = left + (right - left) * (width > 0.0 ? clamp(float(target - at_left) / width, 0.0, 1.0) : 0.5);
    double below = column_at(column, v.x0, m, size), above = column_at(column, v.x1, m, size);
    target = below + ab.y * (above - below);
    int row = j.first;
    end = j.last + 1;
    while (end - row > 1) {
        int middle = (row + end) / 2;
        double here = sum_at(column + 1, middle, m) - sum_at(column, middle, m);
        if (here <= target) { row = middle; below = here; } else { end = middle; above = here; }
    }
    float bottom = max(float(row), v.x0), top = min(float(row + 1), v.x1), height = float(above - below);
    float y = bottom + (top - bottom) * (height > 0.0 ? clamp(float(target - below) / height, 0.0, 1.0) : 0.5);
    share = vec2((x - u.x0) / (u.x1 - u.x0), (y - v.x0) / (v.x1 - v.x0));
    return ivec2(column, row);
}

// Of the cell that a sample leaves through.
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
    float share[IMAGES];
    for (int m = 0; m < IMAGES; ++m) total += share[m] = image_share(m, p, size);
    if (total <= 0.0) discard;
    forget_cells();
    vec3 shift = texelFetch(shifts, pixel % textureSize(shifts, 0), 0).xyz;
    float ratio = plane_distance / (p.z * spacing);
    float passed = 0.0;
    int drawn = 0;
    vec3 sum = vec3(0.0);
    for (int m = 0; m < IMAGES; ++m) {
        float expected = float(samples) * (share[m] / total);
        int number = int(floor(passed + expected + shift.z)) - int(floor(passed + shift.z));
        passed += expected;
        float divisor = expected;
        if (expected > float(most)) { number = most; divisor = float(most); }
        if (number <= 0) continue;
        AxisBox u, v;
        vec2 centre;
        image_boxes(m, p, size, u, v, centre);
        dvec2 ends = dvec2(strip(u.x0, v.x0, v.x1, m, size), strip(u.x1, v.x0, v.x1, m, size));
        float weight = ratio * ratio * share[m] / divisor;
        for (int k = 0; k < number; ++k, ++drawn) {
            vec2 ab = fract(texelFetch(sequence, ivec2(drawn, 0), 0).xy + shift.xy);
            vec2 part;
            ivec2 at = sample_box(u, v, m, size, ends, ab, part);
            vec3 colour = texelFetch(images, ivec3(at, m), 0).rgb;
            float q = dot(abs(colour), vec3(0.2126, 0.7152, 0.0722));
            if (q <= 0.0) continue;
            vec2 place = vec2(mix(u.u0, u.u1, part.x), mix(v.u0, v.u1, part.y));
            vec2 x = (place - centre) / spacing;
            vec3 d = vec3(place, 0.0) - p;
            float r = length(d);
            vec3 value = reflected(surface, d / r);
            if (value == vec3(0.0)) continue;
            sum += colour * value * (weight * basis(x.x) * basis(x.y) * (r / p.z) / q * sample_visibility(place, surface));
        }
    }
    radiance = vec4(max(sum, 0.0) * scale, 0.0);
}
