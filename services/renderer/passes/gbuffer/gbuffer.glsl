// What a pixel sees, from the G-buffer that surface.frag wrote; after normals.glsl and surface_texels.glsl.

uniform mat3 ray_from_pixel;
uniform vec3 eye;

// From the eye through the middle of this fragment; of no unit length.
vec3 pixel_ray() { return ray_from_pixel * vec3(gl_FragCoord.xy, 1.0); }

// In the world; w: 1, or 0 where there is no surface. POINTS: surfaces that no eye sees through its pixels lie where a texture says.
#ifdef POINTS
uniform highp sampler2D surface_places;
vec4 surface_position(ivec2 pixel) { return texelFetch(surface_places, pixel, 0); }
#else
vec4 surface_position(ivec2 pixel) {
    float depth = surface_depth_at(pixel).depth;
    return vec4(eye + depth * pixel_ray(), depth > 0.0 ? 1.0 : 0.0);
}
#endif

// On the viewer's side: for shading, and of the triangle.
vec3 surface_smooth_normal(ivec2 pixel) {
    return direction_from_octahedron(octahedron_from_code(surface_normals_at(pixel).smooth_octahedron));
}

vec3 surface_flat_normal(ivec2 pixel) {
    return direction_from_octahedron(octahedron_from_code(surface_normals_at(pixel).flat_octahedron));
}
