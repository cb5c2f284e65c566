// The alpha test: where a surface is there; after constants.glsl. Where alpha is a coverage, a hash of the place decides (Wyman and McGuire
// 2017, Hashed Alpha Testing), in cells of the power of two that is one to two pixels wide: the pattern stays with the surface when it moves.

// A step of a congruential generator with permuted output (Jarzynski and Olano 2020, Hash Functions for GPU Rendering).
uint pcg_hash(uint state) {
    state = state * 747796405u + 2891336453u;
    uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

#ifdef GL_ES
uint bitfieldReverse(uint x) {
    x = (x & 0x55555555u) << 1u | (x >> 1u & 0x55555555u);
    x = (x & 0x33333333u) << 2u | (x >> 2u & 0x33333333u);
    x = (x & 0x0f0f0f0fu) << 4u | (x >> 4u & 0x0f0f0f0fu);
    x = (x & 0x00ff00ffu) << 8u | (x >> 8u & 0x00ff00ffu);
    return x << 16u | x >> 16u;
}
#endif

// A permutation in which each bit depends on those below it (Laine and Karras 2011): of reversed bits, a nested uniform scramble (Owen 1995).
uint laine_karras_permutation(uint x, uint seed) {
    x += seed;
    x ^= x * 0x6c50b47cu;
    x ^= x * 0xb82f1e52u;
    x ^= x * 0xc7afe638u;
    x ^= x * 0x8d22f6e6u;
    return x;
}

const float CELL_OFFSET = 0.37;  // planes through 0, such as the faces of boxes, lie inside cells; any value in 0.2 to 0.45 does

// A number in (0, 1) for each place and each sample number. Those of 2^n successive samples at one place are evenly spread, in an order of its
// own at each place: a van der Corput sequence, shuffled and scrambled (Burley 2020, Practical Hash-based Owen Scrambling).
float alpha_threshold(vec3 place, uint sample_number) {
    float width = max(max(length(dFdx(place)), length(dFdy(place))), 1e-30);
    ivec3 cell = ivec3(floor(place * exp2(-ceil(log2(width))) + CELL_OFFSET));
    uint seed = pcg_hash(uint(cell.x) + pcg_hash(uint(cell.y) + pcg_hash(uint(cell.z))));
    uint shuffled = laine_karras_permutation(bitfieldReverse(sample_number), seed);
    uint even = bitfieldReverse(laine_karras_permutation(bitfieldReverse(shuffled), pcg_hash(seed)));
    return (float(even >> 8u) + 0.5) / 16777216.0;
}

// nearest, mean: alpha of the texel and over the pixel's area. A mask compares the former with its cutoff, a coverage the latter with a hash.
bool fails_alpha_test(float nearest, float mean, float cutoff, vec3 place, uint sample_number) {
    float threshold = alpha_threshold(place, sample_number);
    return cutoff == HASHED_ALPHA ? mean < threshold : nearest < cutoff;
}
