#version 430
// One instance draws the casters into one light's tile of the atlas.
#include "light.glsl"
#include "lights.glsl"

const float SUNK = 0.9;  // of the bias: how far a floor lies nearer to the light, so that none comes through at an object's foot

in vec3 position;
uniform int first_light;
uniform mat4 world_from_rest;
#ifdef CUT
in vec3 hole;
out vec3 hole_here;
out vec3 rest_position;
flat out uint sampled;
#endif
#if BEYOND
out float gl_ClipDistance[4];  // what reaches beyond the map ends at its empty rim
#endif

void main() {
    int i = first_light + gl_InstanceID;
    vec4 p = world_from_rest * vec4(position, 1.0);
    vec2 own = vec2(dot(lights[i].column, p), dot(lights[i].row, p));
    vec2 texel = lights[i].tile.xy + own;
    float depth = dot(lights[i].depth, p);
#if BEYOND
    depth -= SUNK * lights[i].direction.w;
    gl_ClipDistance[0] = own.x - GUTTER;
    gl_ClipDistance[1] = own.y - GUTTER;
    gl_ClipDistance[2] = lights[i].tile.z - GUTTER - own.x;
    gl_ClipDistance[3] = lights[i].tile.z - GUTTER - own.y;
#endif
    gl_Position = vec4(2.0 * texel * atlas_texel - 1.0, 2.0 * depth - 1.0, 1.0);
#ifdef CUT
    hole_here = hole;
    rest_position = position;
    sampled = uint(lights[i].irradiance.w);
#endif
}
