#version 430
// One instance draws the casters into one light's tile of the atlas.
#include "light.glsl"

in vec3 position;
uniform int first_light;

void main() {
    vec4 light = lights[2 * (first_light + gl_InstanceID)];
    int box = int(lights[2 * (first_light + gl_InstanceID) + 1].w);
    LightFrame frame = light_frame(light.xyz, box_half[box]);
    vec3 texel = tile_from_box(position - box_centre[box], light.xyz, frame);
    gl_Position = vec4((tile_corner(light.w) + texel.xy) / (0.5 * tile_size * tile_columns) - 1.0, 2.0 * texel.z - 1.0, 1.0);
}
