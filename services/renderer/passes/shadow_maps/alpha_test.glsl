// Surfaces with holes: where they are there. For alpha that is a share, a hash of the place decides (Wyman and McGuire 2017, Hashed Alpha
// Testing), in cells of the power of two that is one to two pixels wide: what is seen of them stays with the surface when it moves.

// A step of a congruential generator with permuted output (Jarzynski and Olano 2020).
uint mixed(uint state) {
    state = state * 747796405u + 2891336453u;
    uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

// Bits in which each depends on those below it (Laine and Karras 2011): of reversed numbers, a nested uniform scramble (Owen 1995).
uint scrambled(uint x, uint seed) {
    x += seed;
    x ^= x * 0x6c50b47cu;
    x ^= x * 0xb82f1e52u;
    x ^= x * 0xc7afe638u;
    x ^= x * 0x8d22f6e6u;
    return x;
}

// A number in 0 .. 1 for each place and each `sampled`. Those of 2^n successive ones at one place are evenly spread, and in an order of its
// own at every other: a van der Corput sequence whose numbers are shuffled and whose values are scrambled (Burley 2020).
float threshold(vec3 place, uint sampled) {
    float width = max(max(length(dFdx(place)), length(dFdy(place))), 1e-30);
    ivec3 cell = ivec3(floor(place * exp2(-ceil(log2(width))) + 0.37));  // 0.37: planes through 0 lie inside cells
    uint seed = mixed(uint(cell.x) + mixed(uint(cell.y) + mixed(uint(cell.z))));
    uint shuffled = scrambled(bitfieldReverse(sampled), seed);
    uint even = bitfieldReverse(scrambled(bitfieldReverse(shuffled), mixed(seed)));
    return (float(even >> 8u) + 0.5) / 16777216.0;
}

// alpha: as it is, and as the mean over the pixel. cutoff: below 0 the mean is the share that is there.
bool cut_away(float alpha, float mean, float cutoff, vec3 place, uint sampled) {
    float least = threshold(place, sampled);
    return cutoff < 0.0 ? mean < least : alpha < cutoff;
}
