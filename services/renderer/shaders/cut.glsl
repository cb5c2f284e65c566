// Surfaces with holes: where they are there. For alpha that is a share, a hash of the place decides (Wyman and McGuire 2017, Hashed Alpha
// Testing), in cells of the power of two that is one to two pixels wide: what is seen of them stays with the surface when it moves.

// Steps of a congruential generator with permuted output, one for each coordinate (Jarzynski and Olano 2020).
uint mixed(uint state) {
    state = state * 747796405u + 2891336453u;
    uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

// A number in 0 .. 1 for each place. Of numbers `sampled` that are spread evenly as fractions of 2^32, those at one place are spread as
// evenly, and in another order at every other place: a nested uniform scramble (Owen 1995) by hashing (Laine and Karras 2011).
float threshold(vec3 place, uint sampled) {
    float width = max(max(length(dFdx(place)), length(dFdy(place))), 1e-30);
    ivec3 cell = ivec3(floor(place * exp2(-ceil(log2(width))) + 0.37));  // 0.37: planes through 0 lie inside cells
    uint seed = mixed(uint(cell.x) + mixed(uint(cell.y) + mixed(uint(cell.z))));
    uint x = bitfieldReverse(sampled) + seed;
    x ^= x * 0x6c50b47cu;
    x ^= x * 0xb82f1e52u;
    x ^= x * 0xc7afe638u;
    x ^= x * 0x8d22f6e6u;
    return (float(bitfieldReverse(x) >> 8u) + 0.5) / 16777216.0;
}

// alpha: as it is, and as the mean over the pixel. cutoff: below 0 the mean is the share that is there.
bool cut_away(float alpha, float mean, float cutoff, vec3 place, uint sampled) {
    float least = threshold(place, sampled);
    return cutoff < 0.0 ? mean < least : alpha < cutoff;
}
