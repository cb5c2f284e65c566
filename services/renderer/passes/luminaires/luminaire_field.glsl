// A light field between two planes, its summed-area tables, and what a point sees of each image: tables.py, in GLSL. Tables are float64, as
// pairs of words, and only their differences become float32: a pixel 10^5 times the mean would cancel its neighbours otherwise.

uniform usampler2DArray sums;
uniform sampler2DArray images;
uniform vec2 first_m;  // centre of the first basis function
uniform ivec2 grid;  // functions along u and v
uniform vec4 window;  // s_min, t_min, width and height of a pixel
uniform float plane_distance;
uniform float spacing;

const float SUPPORT = float(SUPPORT_CELLS);

float basis(float x) {
    float a = abs(x);
#if SUPPORT_CELLS == 2
    return a <= 0.5 ? 1.0 - 2.0 * a * a : a < 1.0 ? 2.0 * (1.0 - a) * (1.0 - a) : 0.0;
#else
    return a <= 0.5 ? 0.75 - a * a : a < 1.5 ? 0.5 * (1.5 - a) * (1.5 - a) : 0.0;
#endif
}

float importance(ivec3 at) { return dot(abs(texelFetch(images, at, 0).rgb), LUMINANCE_WEIGHTS); }

double sum_at(int x, int y, int m) { return packDouble2x32(texelFetch(sums, ivec3(x, y, m), 0).xy); }

// The part of an image that a point sees through a basis function: pixels x0, x1, and u0, u1 at them; count: of the axis.
struct AxisBox { float x0, x1, u0, u1; };

AxisBox axis_box(float centre, float p, float ratio, float origin, float pixel, float count) {
    float low = centre - 0.5 * SUPPORT * spacing, high = centre + 0.5 * SUPPORT * spacing;
    float a = (low + ratio * (p - low) - origin) / pixel, b = (high + ratio * (p - high) - origin) / pixel;
    if (b < a) {
        float previous = a; a = b; b = previous;
        previous = low; low = high; high = previous;
    }
    if (b < 0.0 || a >= count || (b <= 0.0 && a < 0.0)) return AxisBox(1.0, 0.0, low, high);
    float x0 = max(a, 0.0), x1 = min(b, count);
    if (b <= a) return AxisBox(x0, x1, low, high);
    return AxisBox(x0, x1, low + (high - low) * ((x0 - a) / (b - a)), low + (high - low) * ((x1 - a) / (b - a)));
}

// The pixels at the ends of an interval and, for two neighbours, the fraction of it that lies in the first.
struct PixelPair { int first, last; float weight; };

PixelPair pixel_pair(float x0, float x1, int count) {
    int first = min(int(x0), count - 1), last = min(int(x1), count - 1);
    return PixelPair(first, last, last > first ? (float(first + 1) - x0) / (x1 - x0) : 1.0);
}

// Importance between rows y0 and y1 left of x: linear in x between integers.
double strip(float x, float y0, float y1, int m, ivec2 size) {
    int i = min(int(x), size.x - 1), j0 = min(int(y0), size.y - 1), j1 = min(int(y1), size.y - 1);
    double f = double(x) - i, g0 = double(y0) - j0, g1 = double(y1) - j1;
    double low = (1.0 - f) * ((1.0 - g1) * sum_at(i, j1, m) + g1 * sum_at(i, j1 + 1, m) - (1.0 - g0) * sum_at(i, j0, m) - g0 * sum_at(i, j0 + 1, m));
    if (f == 0.0) return low;
    return low + f * ((1.0 - g1) * sum_at(i + 1, j1, m) + g1 * sum_at(i + 1, j1 + 1, m) - (1.0 - g0) * sum_at(i + 1, j0, m) - g0 * sum_at(i + 1, j0 + 1, m));
}

double column_at(int i, float y, int m, ivec2 size) {
    int j = min(int(y), size.y - 1);
    double g = double(y) - j;
    return (1.0 - g) * (sum_at(i + 1, j, m) - sum_at(i, j, m)) + g * (sum_at(i + 1, j + 1, m) - sum_at(i, j + 1, m));
}

float mean_importance(AxisBox u, AxisBox v, int m, ivec2 size) {
    PixelPair i = pixel_pair(u.x0, u.x1, size.x), j = pixel_pair(v.x0, v.x1, size.y);
    if (i.last - i.first <= 1 && j.last - j.first <= 1) {
        float low = mix(importance(ivec3(i.last, j.first, m)), importance(ivec3(i.first, j.first, m)), i.weight);
        float high = mix(importance(ivec3(i.last, j.last, m)), importance(ivec3(i.first, j.last, m)), i.weight);
        return mix(high, low, j.weight);
    }
    if (u.x1 <= u.x0 || v.x1 <= v.x0) return 0.0;
    return max(float(strip(u.x1, v.x0, v.x1, m, size) - strip(u.x0, v.x0, v.x1, m, size)), 0.0) / ((u.x1 - u.x0) * (v.x1 - v.x0));
}

// The boxes of image m; false where the point sees nothing of it.
bool image_boxes(int m, vec3 p, ivec2 size, out AxisBox u, out AxisBox v, out vec2 centre) {
    centre = first_m + spacing * vec2(m % grid.x, m / grid.x);
    float ratio = plane_distance / p.z;
    u = axis_box(centre.x, p.x, ratio, window.x, window.z, float(size.x));
    v = axis_box(centre.y, p.y, ratio, window.y, window.w, float(size.y));
    return u.x1 >= u.x0 && v.x1 >= v.x0;
}

// The integral of an image's importance over the part of U that the point sees.
float image_weight(int m, vec3 p, ivec2 size) {
    AxisBox u, v;
    vec2 centre;
    if (!image_boxes(m, p, size, u, v, centre)) return 0.0;
    return mean_importance(u, v, m, size) * abs((u.u1 - u.u0) * (v.u1 - v.u0));
}

float cell_visibilities[MAX_MAPS];  // of this pixel; below 0: not looked up yet

void clear_cell_visibilities() { for (int k = 0; k < MAX_MAPS; ++k) cell_visibilities[k] = -1.0; }

// Fraction of a cell's light that reaches the surface; each map is looked up at most once a pixel.
float cell_visibility(ivec2 cell, Surface surface) {
    int index = cell.y * (grid.x + SUPPORT_CELLS - 1) + cell.x;
    if (cell_visibilities[index] < 0.0) cell_visibilities[index] = map_visibility(index, surface);
    return cell_visibilities[index];
}
