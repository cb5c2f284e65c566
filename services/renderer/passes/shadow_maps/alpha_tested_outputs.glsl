// What shadow_alpha_test.frag reads of a vertex; after alpha_tested_vertex.glsl.

out vec2 alpha_uv_here;
out float alpha_here;
out vec3 rest_position;
flat out uint sample_number;  // another pattern of hashed alpha for each map, so that the patterns average out over the lights

void pass_alpha(uint number) {
    alpha_uv_here = alpha_uv;
    alpha_here = vertex_alpha;
    rest_position = position;
    sample_number = number;
}
