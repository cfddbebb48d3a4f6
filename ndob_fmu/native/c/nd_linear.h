/* What the methods of linear algebra have in common. */
#ifndef ND_LINEAR_H
#define ND_LINEAR_H

#include "nd.h"

bool nd_all_finite(nd x);
nd nd_failed(nd_arena *a, nd like); /* says that there is no solution */

/* Make v (length n) into the direction of the reflection that leaves its first entry only; return that entry. v[0] is
   set to 1, and *tau to the factor of v vT. */
double nd_reflection(double *v, int n, double *tau);
void nd_reflect(double *x, const double *v, int n, double tau);

/* The first `count` columns of the orthogonal factor of A (m,n), as rows. */
nd nd_orthogonal_rows(nd_arena *a, nd A, int count);

#endif
