// The fraction of a light that arrives at a pixel, 0 where the surface faces away from a point; after lights.glsl and visibility.glsl. CACHED_VISIBILITY: it was looked up or traced
// before, and lies in a layer.

#if CACHED_VISIBILITY
uniform sampler2DArray cached_visibility;
#endif

// cosine: dot(flat_normal, direction) of light i.
float arriving(int i, ivec2 pixel, vec4 position, vec3 flat_normal, float cosine) {
#if CACHED_VISIBILITY
    return texelFetch(cached_visibility, ivec3(pixel, int(lights[i].map)), 0).r;
#else
    return cosine > 0.0 ? visibility(i, position, flat_normal, cosine) : 0.0;
#endif
}
