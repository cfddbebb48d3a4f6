/* Two numbers at a time, where the compiler has types for that: each has the bits that it has alone. */
#ifndef ND_PAIRS_H
#define ND_PAIRS_H

#ifdef __GNUC__
typedef double two __attribute__((vector_size(16)));
typedef double two_in_memory __attribute__((vector_size(16), aligned(8), may_alias));
static inline two two_of(double x) { return (two){x, x}; }
static inline two two_at(const double *p) { return *(const two_in_memory *)p; }
static inline void put_two(double *p, two x) { *(two_in_memory *)p = x; }
#define ND_TIMES(x, y) ((x) * (y))
#define ND_PLUS(x, y) ((x) + (y))
#else
typedef struct {
    double p, q;
} two;
static inline two two_of(double x) { return (two){x, x}; }
static inline two two_at(const double *p) { return (two){p[0], p[1]}; }
static inline void put_two(double *p, two x) { p[0] = x.p, p[1] = x.q; }
#define ND_TIMES(x, y) ((two){(x).p * (y).p, (x).q * (y).q})
#define ND_PLUS(x, y) ((two){(x).p + (y).p, (x).q + (y).q})
#endif

#endif
