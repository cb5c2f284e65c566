// What weak lights would give to a surface of some normal without shadows, in luminance and roughly: spherical harmonics to the second order.

uniform float by_normal[9];  // weak_lights.py
uniform float least_by_normal;

float unshadowed_by_normal(vec3 n) {
    float value = by_normal[0] + by_normal[1] * n.y + by_normal[2] * n.z + by_normal[3] * n.x;
    value += by_normal[4] * n.x * n.y + by_normal[5] * n.y * n.z + by_normal[6] * (3.0 * n.z * n.z - 1.0);
    value += by_normal[7] * n.x * n.z + by_normal[8] * (n.x * n.x - n.y * n.y);
    return max(value, least_by_normal);
}
