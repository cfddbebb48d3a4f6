/* Numbers and messages as text: what printf writes in the locale "C", without it. Controllers have none, or a large one,
   and that of a host goes by its locale. */
#include "nd_text.h"

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

enum { LIMBS = 144, LIMB_DIGITS = 9, LIMB = 1000000000, DIGITS = 340, ROUND_TRIP = 17, LEAST_EXPONENT = -1074 };

/* A number > 0 in decimal digits: 0.d₀d₁… 10^point, cut behind the last one. */
typedef struct {
    char digits[DIGITS];
    int count, point;
    bool more; /* whether it is larger than that */
} Decimal;

/* m 2^e in limbs, from the one that is returned to `end`; that of units is the third, or the last where e > 0. */
static int limbs_of(uint64_t m, int e, uint32_t *limbs, int *end) {
    int units = e > 0 ? LIMBS - 1 : 2, first = units - 2;
    for (int i = units; i >= first; i--, m /= LIMB) limbs[i] = (uint32_t)(m % LIMB);
    *end = units + 1;
    for (; e > 0; e -= 29) {
        uint64_t carry = 0;
        for (int i = units; i >= first; i--) {
            uint64_t x = ((uint64_t)limbs[i] << (e < 29 ? e : 29)) + carry;
            limbs[i] = (uint32_t)(x % LIMB), carry = x / LIMB;
        }
        if (carry) limbs[--first] = (uint32_t)carry;
    }
    for (; e < 0 && units == 2; e += 9) {
        uint32_t carry = 0;
        int shift = e > -9 ? -e : 9;
        for (int i = first; i < *end; i++) {
            uint32_t rest = limbs[i] & ((1u << shift) - 1);
            limbs[i] = (limbs[i] >> shift) + carry;
            carry = (uint32_t)(LIMB >> shift) * rest;
        }
        if (carry) limbs[(*end)++] = carry;
    }
    return first;
}

/* m 2^e with 0 < m < 2^55, exact but for what is cut. */
static void to_decimal(uint64_t m, int e, Decimal *to) {
    uint32_t limbs[LIMBS];
    int end, first = limbs_of(m, e, limbs, &end), units = e > 0 ? LIMBS - 1 : 2, zeros = 0;
    while (!limbs[first]) first++;
    to->count = 0;
    to->more = false;
    for (int i = first; i < end; i++) {
        if (to->count + LIMB_DIGITS > DIGITS) {
            to->more = to->more || limbs[i];
            continue;
        }
        for (uint32_t k = LIMB / 10, left = limbs[i]; k; left %= k, k /= 10) {
            int digit = (int)(left / k);
            if (!to->count && !digit) zeros++;
            else to->digits[to->count++] = (char)digit;
        }
    }
    to->point = (units - first + 1) * LIMB_DIGITS - zeros;
}

/* Add one to the last digit. */
static void raise_last(Decimal *x) {
    for (int i = x->count - 1; i >= 0; i--) {
        if (++x->digits[i] < 10) return;
        x->digits[i] = 0;
    }
    memmove(x->digits + 1, x->digits, (size_t)x->count);
    x->digits[0] = 1;
    x->point++;
    if (!x->count) x->count = 1;
}

/* Round to so many digits, half to even, as printf does; less than one digit leaves none, or one. */
static void round_to(Decimal *x, int count) {
    if (count >= x->count) {
        for (; x->count < count && x->count < DIGITS; x->count++) x->digits[x->count] = 0;
        return;
    }
    bool up = false;
    if (count >= 0) {
        bool beyond = x->more;
        for (int i = count + 1; i < x->count; i++) beyond = beyond || x->digits[i];
        up = x->digits[count] > 5 || (x->digits[count] == 5 && (beyond || (count && x->digits[count - 1] % 2)));
    }
    x->count = count > 0 ? count : 0;
    x->more = false;
    if (up) raise_last(x);
}

static void split_number(double size, uint64_t *m, int *e) {
    *m = (uint64_t)ldexp(frexp(size, e), 53);
    *e -= 53;
    if (*e < LEAST_EXPONENT) *m >>= LEAST_EXPONENT - *e, *e = LEAST_EXPONENT;
}

typedef struct {
    char *to;
    size_t left; /* with the end */
} TextLine;

static void put(TextLine *line, const char *text, int most) {
    for (; *text && most && line->left > 1; text++, most--, line->left--) *line->to++ = *text;
    *line->to = '\0';
}

static void put_character(TextLine *line, char c) { put(line, (char[]){c, '\0'}, -1); }

static void put_digits(TextLine *line, const Decimal *x, int from, int count) {
    for (int i = from; i < from + count; i++) put_character(line, (char)('0' + (i >= 0 && i < x->count ? x->digits[i] : 0)));
}

static void put_integer(TextLine *line, unsigned number, int least) {
    char digits[12] = "";
    int i = 11;
    for (; number || least > 0; number /= 10, least--) digits[--i] = (char)('0' + number % 10);
    put(line, digits + i, -1);
}

static void put_exponent(TextLine *line, int exponent) {
    put(line, exponent < 0 ? "e-" : "e+", -1);
    put_integer(line, (unsigned)(exponent < 0 ? -exponent : exponent), 2);
}

/* `count` digits, of which those behind the first stand behind the point. */
static void put_scientific(TextLine *line, const Decimal *x, int count) {
    put_digits(line, x, 0, 1);
    if (count > 1) put_character(line, '.');
    put_digits(line, x, 1, count - 1);
    put_exponent(line, x->point - 1);
}

static void put_plain(TextLine *line, const Decimal *x, int decimals) {
    if (x->point > 0) put_digits(line, x, 0, x->point);
    else put_character(line, '0');
    if (decimals > 0) put_character(line, '.');
    put_digits(line, x, x->point, decimals);
}

static void put_general(TextLine *line, Decimal *x, int digits) {
    round_to(x, digits);
    while (x->count > 1 && !x->digits[x->count - 1]) x->count--;
    if (x->point > -4 && x->point <= digits) put_plain(line, x, x->count > x->point ? x->count - x->point : 0);
    else put_scientific(line, x, x->count);
}

static void put_number(TextLine *line, char form, int precision, bool plus, double number) {
    if (number != number) {
        put(line, plus ? "+nan" : "nan", -1);
        return;
    }
    if (signbit(number)) put_character(line, '-');
    else if (plus) put_character(line, '+');
    double size = fabs(number);
    if (size > 1.7976931348623157e308) {
        put(line, "inf", -1);
        return;
    }
    Decimal x = {{0}, 1, 1, false};
    uint64_t m;
    int e;
    split_number(size, &m, &e);
    if (size > 0.0) to_decimal(m, e, &x);
    if (form == 'g') put_general(line, &x, precision);
    if (form == 'e') {
        round_to(&x, precision + 1);
        put_scientific(line, &x, precision + 1);
    }
    if (form == 'f') {
        round_to(&x, x.point + precision);
        if (!x.count) x.point = 0;
        put_plain(line, &x, precision);
    }
}

void nd_print_of(char *to, size_t size, const char *format, va_list arguments) {
    TextLine line = {to, size};
    *to = '\0';
    for (; *format; format++) {
        if (*format != '%') {
            put_character(&line, *format);
            continue;
        }
        bool plus = *++format == '+';
        int precision = -1;
        if (plus) format++;
        if (*format == '.')
            for (precision = 0, format++; *format >= '0' && *format <= '9'; format++) precision = 10 * precision + *format - '0';
        if (*format == 's') put(&line, va_arg(arguments, const char *), precision);
        else if (*format == 'd') {
            int number = va_arg(arguments, int);
            if (number < 0) put_character(&line, '-');
            put_integer(&line, number < 0 ? 0u - (unsigned)number : (unsigned)number, 1);
        } else if (*format == '%') put_character(&line, '%');
        else put_number(&line, *format, precision < 0 ? 6 : precision, plus, va_arg(arguments, double));
    }
}

void nd_print(char *to, size_t size, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    nd_print_of(to, size, format, arguments);
    va_end(arguments);
}

/* Whether the digits of x lie below those of a limit, or above, or are the same: −1, 1, 0. */
static int beside(const Decimal *x, const Decimal *limit) {
    if (x->point != limit->point) return x->point < limit->point ? -1 : 1;
    for (int i = 0; i < x->count || i < limit->count; i++) {
        int u = i < x->count ? x->digits[i] : 0, v = i < limit->count ? limit->digits[i] : 0;
        if (u != v) return u < v ? -1 : 1;
    }
    return limit->more ? -1 : 0;
}

/* The fewest digits that are nearer to the number than to those beside it, in the form of Python's repr. */
void nd_shortest(char *to, size_t size, double number) {
    TextLine line = {to, size};
    double least = fabs(number);
    *to = '\0';
    if (!(least <= 1.7976931348623157e308) || least == 0.0) {
        nd_print(to, size, least == 0.0 ? "%.1f" : "%g", number);
        return;
    }
    uint64_t m;
    int e;
    Decimal below, above, x, exact;
    split_number(least, &m, &e);
    bool even = m % 2 == 0, is_first = m == (uint64_t)1 << 52 && e > LEAST_EXPONENT;
    /* The numbers below a power of two are nearer to it. */
    to_decimal(4 * m - (is_first ? 1 : 2), e - 2, &below);
    to_decimal(4 * m + 2, e - 2, &above);
    to_decimal(m, e, &exact);
    int digits = 0;
    do {
        x = exact;
        round_to(&x, ++digits);
        int low = beside(&x, &below);
        if (is_first && (low < 0 || (low == 0 && !even))) {
            raise_last(&x);
            low = 1;
        }
        int high = beside(&x, &above);
        if ((low > 0 || (low == 0 && even)) && (high < 0 || (high == 0 && even))) break;
    } while (digits < ROUND_TRIP);
    while (x.count > 1 && !x.digits[x.count - 1]) x.count--;
    if (signbit(number)) put_character(&line, '-');
    int exponent = x.point - 1, decimals = x.count - x.point;
    if (exponent >= -4 && exponent < 16) put_plain(&line, &x, decimals < 1 ? 1 : decimals);
    else put_scientific(&line, &x, x.count);
}
