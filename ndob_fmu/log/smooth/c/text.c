/* Lines of numbers, each with the fewest digits that give it back, in the form of Python's repr (Giulietti, 2020,
   "The Schubfach way to render doubles", whose letters these are). */

/* g of 10^-292 … 10^324: the 128 leading bits of each, rounded up; POWERS stands before this text. */
enum { LEAST_POWER = -292, HIDDEN = 52, BIAS = 1075, LONGEST = 25 };

typedef struct {
    uint64_t digits;
    int exponent;
} Decimal;

__extension__ typedef unsigned __int128 Wide;

static uint64_t round_to_odd(const uint64_t *g, uint64_t c)
{
    Wide low = (Wide)g[1] * c, high = (Wide)g[0] * c + (uint64_t)(low >> 64);
    return (uint64_t)(high >> 64) | ((uint64_t)high > 1);
}

/* The shortest decimal number in the interval of numbers that are rounded to this one, and the nearest of those. */
static Decimal shortest(uint64_t fraction, int exponent)
{
    uint64_t c = exponent ? fraction | (uint64_t)1 << HIDDEN : fraction;
    int q = (exponent ? exponent : 1) - BIAS;
    if (q <= 0 && -q <= HIDDEN && !(c & (((uint64_t)1 << -q) - 1))) return (Decimal){c >> -q, 0};
    int is_odd = c & 1, is_closer = !fraction && exponent > 1; /* the lower neighbour of a power of two */
    int k = (q * 1262611 - (is_closer ? 524031 : 0)) >> 22, h = q + ((-k * 1741647) >> 19) + 1;
    const uint64_t *g = POWERS[-k - LEAST_POWER];
    uint64_t lower = round_to_odd(g, (4 * c - 2 + (uint64_t)is_closer) << h) + (uint64_t)is_odd;
    uint64_t middle = round_to_odd(g, 4 * c << h), upper = round_to_odd(g, (4 * c + 2) << h) - (uint64_t)is_odd;
    uint64_t s = middle / 4, tens = s / 10;
    if (s >= 10) {
        int below = lower <= 40 * tens, above = 40 * tens + 40 <= upper;
        if (below != above) return (Decimal){tens + (uint64_t)above, k + 1};
    }
    int below = lower <= 4 * s, above = 4 * s + 4 <= upper;
    if (below != above) return (Decimal){s + (uint64_t)above, k};
    uint64_t half = 4 * s + 2;
    return (Decimal){s + (middle > half || (middle == half && (s & 1))), k};
}

static char *put(char *to, const char *text)
{
    while (*text) *to++ = *text++;
    return to;
}

static char *put_zeros(char *to, int count)
{
    for (; count > 0; count--) *to++ = '0';
    return to;
}

static char *put_digits(char *to, const char *digits, int count)
{
    memcpy(to, digits, (size_t)count);
    return to + count;
}

/* As repr: d.dde±xx below 1e-4 and from 1e16 on. */
static char *put_number(char *to, double number)
{
    uint64_t bits;
    memcpy(&bits, &number, sizeof bits);
    uint64_t fraction = bits & (((uint64_t)1 << HIDDEN) - 1);
    int exponent = (int)(bits >> HIDDEN) & 2047;
    if (exponent == 2047 && fraction) return put(to, "nan");
    if (bits >> 63) *to++ = '-';
    if (exponent == 2047) return put(to, "inf");
    if (!exponent && !fraction) return put(to, "0.0");
    Decimal found = shortest(fraction, exponent);
    while (!(found.digits % 10)) found.digits /= 10, found.exponent++;
    char text[20], *digits = text + 20;
    for (uint64_t left = found.digits; left; left /= 10) *--digits = (char)('0' + left % 10);
    int count = (int)(text + 20 - digits), point = count + found.exponent; /* 0.d₀d₁… 10^point */
    if (point > 16 || point < -3) {
        *to++ = digits[0];
        if (count > 1) {
            *to++ = '.';
            to = put_digits(to, digits + 1, count - 1);
        }
        int e = point - 1, size = e < 0 ? -e : e;
        *to++ = 'e';
        *to++ = e < 0 ? '-' : '+';
        if (size >= 100) *to++ = (char)('0' + size / 100);
        *to++ = (char)('0' + size / 10 % 10);
        *to++ = (char)('0' + size % 10);
        return to;
    }
    if (point <= 0) return put_digits(put_zeros(put(to, "0."), -point), digits, count);
    if (point >= count) return put(put_zeros(put_digits(to, digits, count), point - count), ".0");
    to = put_digits(to, digits, point);
    *to++ = '.';
    return put_digits(to, digits + point, count - point);
}

/* Write lines of numbers (K,columns) to `to`, which holds LONGEST characters of each; return how many they are.
   whole (columns,): 1 where the numbers are whole, and are written as such */
SHARED size_t ndob_lines(size_t K, size_t columns, const double *numbers, const unsigned char *whole, char *to)
{
    char *end = to;
    for (size_t k = 0; k < K; k++) {
        for (size_t i = 0; i < columns; i++, numbers++) {
            end = put_number(end, *numbers);
            if (whole[i]) end -= 2; /* ".0" */
            *end++ = i + 1 < columns ? ',' : '\n';
        }
    }
    return (size_t)(end - to);
}
