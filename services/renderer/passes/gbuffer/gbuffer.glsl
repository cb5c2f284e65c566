// What a pixel sees, as surface.frag left it; after normals.glsl.

uniform mat3 ray_from_pixel;
uniform vec3 eye;
uniform sampler2D surface_depths;  // how often the pixel's ray goes into the way there; 0 where there is no surface
uniform sampler2D surface_normals;

const float CODES = 32767.0;  // of 16 bits to each side of 0, which is one itself: axes stay exact

vec3 seen_ray() { return ray_from_pixel * vec3(gl_FragCoord.xy, 1.0); }

// In the world; w: 1, or 0 where there is no surface.
vec4 seen_position() {
    float depth = texelFetch(surface_depths, ivec2(gl_FragCoord.xy), 0).r;
    return vec4(eye + depth * seen_ray(), depth > 0.0 ? 1.0 : 0.0);
}

// Two directions as octahedra: of shading and of the triangle, both on the viewer's side.
vec4 seen_normals() {
    return (texelFetch(surface_normals, ivec2(gl_FragCoord.xy), 0) * (2.0 * CODES + 1.0) - (CODES + 1.0)) / CODES;
}
