#version 430
// One instance draws the casters into one light's tile of the atlas.
#include "light.glsl"
#include "lights.glsl"

in vec3 position;
uniform int first_light;
uniform mat4 world_from_rest;

void main() {
    int i = first_light + gl_InstanceID;
    vec4 p = world_from_rest * vec4(position, 1.0);
    vec2 texel = lights[i].corner_slope.xy + vec2(dot(lights[i].column, p), dot(lights[i].row, p));
    gl_Position = vec4(texel / (0.5 * tile_size * tile_columns) - 1.0, 2.0 * dot(lights[i].depth, p) - 1.0, 1.0);
}
