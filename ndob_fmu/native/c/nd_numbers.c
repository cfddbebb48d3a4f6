/* Numbers alone. */
#include "nd_loops.h"

#include <float.h>

bool nd_is_not_a_number(double x) { return x != x; }

/* The second one counts where it is larger, as in Python's max(x, y): so a NaN before stays, one behind does not. */
double nd_max2(double x, double y) { return y > x ? y : x; }
double nd_min2(double x, double y) { return y < x ? y : x; }
int nd_imax2(int x, int y) { return y > x ? y : x; }
int nd_imin2(int x, int y) { return y < x ? y : x; }

int nd_mod(int x, int y) {
    int r = x % y;
    return r != 0 && (r < 0) != (y < 0) ? r + y : r;
}

int nd_floordiv(int x, int y) { return (x - nd_mod(x, y)) / y; }

int nd_bits(int x) {
    int count = 0;
    for (unsigned left = (unsigned)x; left; left >>= 1) count += (int)(left & 1u);
    return count;
}

int nd_bit_length(int x) {
    int count = 0;
    for (unsigned left = (unsigned)x; left; left >>= 1) count++;
    return count;
}

double nd_factorial(int n) {
    double r = 1.0;
    for (int i = 2; i <= n; i++) r *= i;
    return r;
}

double nd_rounded(double x, int digits) {
    double scale = pow(10.0, digits);
    return nearbyint(x * scale) / scale;
}

double nd_ulp(double x) {
    double size = fabs(x);
    return size <= DBL_MAX ? nextafter(size, HUGE_VAL) - size : size;
}
