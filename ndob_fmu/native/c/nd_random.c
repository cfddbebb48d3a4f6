/* Random numbers as a function of a seed and an index: Philox 4x64 with 10 rounds, as runtime.blocks.random_numbers. */
#include "nd.h"

#include <float.h>

/* The upper 64 bits of a product; the lower ones are x * y. */
static uint64_t upper(uint64_t x, uint64_t y) {
    uint64_t low = (x & 0xffffffffu) * (y & 0xffffffffu), first = (x >> 32) * (y & 0xffffffffu);
    uint64_t second = (x & 0xffffffffu) * (y >> 32), carried = (low >> 32) + (first & 0xffffffffu) + (second & 0xffffffffu);
    return (x >> 32) * (y >> 32) + (first >> 32) + (second >> 32) + (carried >> 32);
}

/* An integer modulo 2⁶⁴, as the runtime takes it. */
static uint64_t word_of(nd_arena *a, double integer) {
    if (!(fabs(integer) <= DBL_MAX)) {
        nd_raise(a, ND_ARITHMETIC, "cannot convert a number that is not finite to an integer");
        return 0;
    }
    uint64_t word = (uint64_t)fmod(fabs(integer), 0x1p64);
    return integer < 0.0 ? 0 - word : word;
}

nd nd_uniforms(nd_arena *a, int seed, double index) {
    const uint64_t multipliers[] = {0xd2e7470ee14c6c93u, 0xca5a826395121157u};
    const uint64_t weyl[] = {0x9e3779b97f4a7c15u, 0xbb67ae8584caa73bu};
    uint64_t k[] = {(uint64_t)(int64_t)seed, 0}, c[] = {word_of(a, index), 0, 0, 0};
    for (int round = 0; round < 10; round++) {
        uint64_t next[] = {upper(multipliers[1], c[2]) ^ c[1] ^ k[0], multipliers[1] * c[2],
                           upper(multipliers[0], c[0]) ^ c[3] ^ k[1], multipliers[0] * c[0]};
        memcpy(c, next, sizeof c);
        k[0] += weyl[0];
        k[1] += weyl[1];
    }
    int four = 4;
    nd drawn = nd_new(a, 1, &four);
    for (int i = 0; i < 4; i++) drawn->p[i] = (double)(c[i] >> 11) * 0x1p-53;
    return drawn;
}
