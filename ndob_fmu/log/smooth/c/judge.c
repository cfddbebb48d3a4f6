/* What an event explains: `event_search.explained_by`, with the same letters. */

/* ½ (lᵀ (I + M)⁻¹ l − log det (I + M)) of l = Jᵀλ and M = JᵀΛJ at K rows, for columns J (K,N,c), scores λ (K,N) and
   their variances Λ (K,N,N); −∞ where I + M is not above 0. */
SHARED int ndob_explained(size_t K, size_t N, size_t c, const double *columns, const double *scores, const double *variances, double *gained)
{
    double *work = malloc((N * c + (c + 1) * (c + 1)) * sizeof(double));
    if (!work) return 0;
    double *moved = work, *left = work + N * c;
    size_t width = c + 1;
    for (size_t k = 0; k < K; k++, columns += N * c, scores += N, variances += N * N) {
        memset(work, 0, (N * c + width * width) * sizeof(double));
        for (size_t i = 0; i < N; i++) /* Λ J */
            for (size_t j = 0; j < N; j++) add(c, moved + i * c, variances[i * N + j], columns + j * c);
        for (size_t i = 0; i < c; i++) left[i * width + i] = 1.0;
        for (size_t j = 0; j < N; j++)
            for (size_t i = 0; i < c; i++) {
                add(c, left + i * width, columns[j * c + i], moved + j * c);
                left[i * width + c] += columns[j * c + i] * scores[j];
            }
        gained[k] = 0.0;
        for (size_t i = 0; i < c; i++) { /* elimination */
            const double *row = left + i * width;
            double pivot = row[i];
            if (pivot <= 0.0) {
                gained[k] = -INFINITY;
                break;
            }
            gained[k] += 0.5 * (row[c] * row[c] / pivot - log(pivot));
            for (size_t below = i + 1; below < c; below++)
                add(c - i, left + below * width + i + 1, -left[below * width + i] / pivot, row + i + 1);
        }
    }
    free(work);
    return 1;
}
