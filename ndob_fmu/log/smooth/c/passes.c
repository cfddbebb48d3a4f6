/* `smoother.forward` and `smoother.backward`, with the same letters. */

/* As `LinearRecord`: K instants of S records with p outputs and N states; noise (K-1,S,N,c).
   jumps: their number, and of each its instant, its columns and, one behind the other, these (S,N,columns) */
typedef struct {
    size_t K, S, p, N, c;
    const double *Phi, *noise, *shift, *rows, *misfit, *variance, *start, *start_factor;
    size_t jumps;
    const size_t *jump_at, *jump_columns;
    const double *jump_values;
} Record;

/* As `Forward`. */
typedef struct {
    double *xi, *factor, *gain, *innovation, *alpha;
} Filtered;

/* As `Adjoint`. */
typedef struct {
    double *of_state, *of_state_variance, *of_sample, *of_sample_variance;
} Scores;

/* Take a sample c ξ + v = y of variance R, for a factor S of P; f: scratch (N,) */
static void measure(size_t N, double *xi, double *S, const double *c, double y, double R, double *gain, double *e, double *alpha, double *f)
{
    memset(f, 0, N * sizeof(double));
    for (size_t j = 0; j < N; j++)
        if (c[j] != 0.0) add(N, f, c[j], S + j * N);
    *alpha = dot(N, f, f) + R;
    *e = y - dot(N, c, xi);
    double part = 1.0 / (1.0 + sqrt(R / *alpha));
    for (size_t j = 0; j < N; j++) {
        gain[j] = dot(N, S + j * N, f) / *alpha;
        xi[j] += *e * gain[j];
        add(N, S + j * N, -part * gain[j], f);
    }
}

/* S ← the triangular factor of [S, columns (N,c)] */
static void widen(Columns *work, double *S, size_t c, const double *columns)
{
    put_rows(work, S);
    add_columns(work, c, columns);
    make_triangular(work);
    take_rows(work, S);
}

/* work: scratch (2N+3,N) */
static void filter_one(const Record *r, size_t s, const Filtered *to, Columns *columns, double *work)
{
    size_t N = r->N, p = r->p, jump = 0;
    double *S = work, *moved = work + N * N, *xi = moved + N * N, *next = xi + N, *f = next + N;
    const double *added = r->jump_values;
    memcpy(xi, r->start + s * N, N * sizeof(double));
    memcpy(S, r->start_factor + s * N * N, N * N * sizeof(double));
    for (size_t k = 0; k < r->K; k++) {
        size_t at = k * r->S + s;
        if (jump < r->jumps && r->jump_at[jump] == k) {
            size_t c = r->jump_columns[jump++];
            widen(columns, S, c, added + s * N * c);
            added += r->S * N * c;
        }
        memcpy(to->xi + at * N, xi, N * sizeof(double));
        memcpy(to->factor + at * N * N, S, N * N * sizeof(double));
        for (size_t i = 0; i < p; i++) {
            size_t sample = at * p + i;
            double *gain = to->gain + sample * N, *e = to->innovation + sample, *alpha = to->alpha + sample;
            if (isfinite(r->misfit[sample])) {
                measure(N, xi, S, r->rows + sample * N, r->misfit[sample], r->variance[sample], gain, e, alpha, f);
            } else {
                memset(gain, 0, N * sizeof(double));
                *e = 0.0;
                *alpha = INFINITY;
            }
        }
        if (k + 1 == r->K) break;
        const double *Phi = r->Phi + at * N * N;
        for (size_t j = 0; j < N; j++) next[j] = dot(N, Phi + j * N, xi) + r->shift[at * N + j];
        memcpy(xi, next, N * sizeof(double));
        multiply(N, Phi, S, moved);
        memcpy(S, moved, N * N * sizeof(double));
        widen(columns, S, r->c, r->noise + at * N * r->c);
    }
}

SHARED int ndob_forward(const Record *r, const Filtered *to)
{
    size_t most = r->c, N = r->N;
    for (size_t j = 0; j < r->jumps; j++) most = r->jump_columns[j] > most ? r->jump_columns[j] : most;
    Columns columns;
    double *work = malloc((2 * N * N + 3 * N) * sizeof(double));
    int good = new_columns(&columns, N, most) && work;
    for (size_t s = 0; good && s < r->S; s++) filter_one(r, s, to, &columns, work);
    free_columns(&columns);
    free(work);
    return good;
}

/* The closed loop at a row, with the letters of `closed_loop`. behind (p,N): Φ K; later (p,N): l; W (p,p) */
typedef struct {
    double *Psi, *H, *W, *behind, *later;
} Loop;

/* Of N states and p outputs with rows c (p,N), gains K (p,N), behind which stands Φ, none behind the last row. */
static void close_loop(const Loop *to, size_t N, size_t p, const double *Phi, const double *rows, const double *gains)
{
    if (Phi) memcpy(to->Psi, Phi, N * N * sizeof(double));
    else {
        memset(to->Psi, 0, N * N * sizeof(double));
        for (size_t i = 0; i < N; i++) to->Psi[i * N + i] = 1.0;
    }
    memcpy(to->H, rows, p * N * sizeof(double));
    memset(to->W, 0, p * p * sizeof(double));
    memset(to->later, 0, p * N * sizeof(double));
    for (size_t i = 0; i < p; i++) {
        double *H = to->H + i * N, *W = to->W + i * p, *behind = to->behind + i * N;
        W[i] = 1.0;
        for (size_t j = 0; j < i; j++) { /* a sample shows the gains of those before it */
            double shown = -dot(N, rows + i * N, gains + j * N);
            add(N, H, shown, to->H + j * N);
            add(p, W, shown, to->W + j * p);
        }
        for (size_t row = 0; row < N; row++) behind[row] = Phi ? dot(N, Phi + row * N, gains + i * N) : gains[i * N + row];
        for (size_t j = 0; j <= i; j++) add(N, to->later + j * N, -W[j], behind);
    }
    for (size_t row = 0; row < N; row++)
        for (size_t i = 0; i < p; i++) add(N, to->Psi + row * N, -to->behind[i * N + row], to->H + i * N);
}

/* u and D of the samples at a row, by λ and Λ behind its step. */
static void sample_scores(const Loop *loop, size_t N, size_t p, const double *score, const double *variance, const double *e,
                          const double *alpha, double *u, double *D)
{
    for (size_t j = 0; j < p; j++) {
        const double *later = loop->later + j * N;
        u[j] = dot(N, later, score);
        D[j] = 0.0;
        for (size_t row = 0; row < N; row++) D[j] += later[row] * dot(N, variance + row * N, later);
        for (size_t i = j; i < p; i++) {
            double W = loop->W[i * p + j];
            u[j] += W * e[i] / alpha[i];
            D[j] += W * W / alpha[i];
        }
    }
}

/* Add Aᵀ V A to the upper triangle of a matrix, for a symmetric V (N,N). work: scratch (2N,N) */
static void add_congruent(size_t N, const double *A, const double *V, double *work, double *to)
{
    double *product = work, *turned = work + N * N;
    memset(product, 0, N * N * sizeof(double));
    for (size_t l = 0; l < N; l++)
        for (size_t i = 0; i < N; i++)
            if (A[l * N + i] != 0.0) add(N, product + i * N, A[l * N + i], V + l * N);
    for (size_t l = 0; l < N; l++)
        for (size_t i = 0; i < N; i++) turned[l * N + i] = product[i * N + l];
    for (size_t l = 0; l < N; l++)
        for (size_t i = 0; i < N; i++)
            if (A[l * N + i] != 0.0) add(N - i, to + i * N + i, A[l * N + i], turned + l * N + i);
}

/* Make a matrix symmetric by its upper triangle. */
static void mirror(size_t N, double *matrix)
{
    for (size_t i = 0; i < N; i++)
        for (size_t l = 0; l < i; l++) matrix[i * N + l] = matrix[l * N + i];
}

/* y += Aᵀ x */
static void add_turned(size_t N, double *y, const double *A, const double *x)
{
    for (size_t l = 0; l < N; l++) add(N, y, x[l], A + l * N);
}

/* λ and Λ before the samples of a row are those that its own samples have, and Ψᵀ λ and Ψᵀ Λ Ψ of those behind its step. */
static void own_scores(const Loop *loop, size_t N, size_t p, const double *e, const double *alpha, double *score, double *variance)
{
    memset(score, 0, N * sizeof(double));
    memset(variance, 0, N * N * sizeof(double));
    for (size_t sample = 0; sample < p; sample++) {
        const double *H = loop->H + sample * N;
        add(N, score, e[sample] / alpha[sample], H);
        for (size_t i = 0; i < N; i++)
            if (H[i] != 0.0) add(N - i, variance + i * N + i, H[i] / alpha[sample], H + i);
    }
    mirror(N, variance);
}

/* The memory of a loop of N states and p outputs, which begins with its Ψ; NULL where there is none. */
static double *new_loop(Loop *made, size_t N, size_t p)
{
    double *memory = malloc((N * N + 3 * p * N + p * p) * sizeof(double));
    if (!memory) return NULL;
    made->Psi = memory;
    made->H = memory + N * N;
    made->behind = made->H + p * N;
    made->later = made->behind + p * N;
    made->W = made->later + p * N;
    return memory;
}

/* The closed loop of a row, and the scores of its own samples. */
static void loop_at(const Loop *loop, const Record *r, const Filtered *found, size_t k, size_t s, double *score, double *variance)
{
    size_t N = r->N, p = r->p, at = k * r->S + s, sample = at * p;
    const double *Phi = k + 1 < r->K ? r->Phi + at * N * N : NULL;
    close_loop(loop, N, p, Phi, r->rows + sample * N, found->gain + sample * N);
    own_scores(loop, N, p, found->innovation + sample, found->alpha + sample, score, variance);
}

SHARED int ndob_backward(const Record *r, const Filtered *found, const Scores *to)
{
    size_t N = r->N, p = r->p;
    Loop loop;
    double *memory = new_loop(&loop, N, p), *work = calloc(3 * N * N + N, sizeof(double));
    double *nothing = work ? work + 2 * N * N : NULL;
    int good = memory && work;
    for (size_t s = 0; good && s < r->S; s++) {
        const double *score = nothing, *variance = nothing; /* behind the step */
        for (size_t k = r->K; k-- > 0;) {
            size_t at = k * r->S + s, sample = at * p;
            double *own = to->of_state + at * N, *own_variance = to->of_state_variance + at * N * N;
            loop_at(&loop, r, found, k, s, own, own_variance);
            sample_scores(&loop, N, p, score, variance, found->innovation + sample, found->alpha + sample, to->of_sample + sample,
                          to->of_sample_variance + sample);
            add_turned(N, own, loop.Psi, score);
            add_congruent(N, loop.Psi, variance, work, own_variance);
            mirror(N, own_variance);
            score = own;
            variance = own_variance;
        }
    }
    free(memory);
    free(work);
    return good;
}

/* What a row's scores are made of, for a block of rows (L,…) and for the rows from its first one on. */
typedef struct {
    double *Psi, *score, *variance, *first, *first_variance, *next, *next_variance;
} Block;

/* The scores of the first row from its own samples and those of r − 1 more rows, r = 0 … L; behind `count` rows there is
   nothing more. */
static void from_first(const Block *block, size_t N, size_t L, size_t count, double *work)
{
    double *A = work + 2 * N * N, *product = A + N * N;
    memset(A, 0, N * N * sizeof(double));
    for (size_t i = 0; i < N; i++) A[i * N + i] = 1.0;
    memset(block->first, 0, N * sizeof(double));
    memset(block->first_variance, 0, N * N * sizeof(double));
    for (size_t r = 0; r + 1 < L; r++) {
        double *score = block->first + (r + 1) * N, *variance = block->first_variance + (r + 1) * N * N;
        memcpy(score, score - N, N * sizeof(double));
        memcpy(variance, variance - N * N, N * N * sizeof(double));
        if (r >= count) continue;
        add_turned(N, score, A, block->score + r * N);
        add_congruent(N, A, block->variance + r * N * N, work, variance);
        mirror(N, variance);
        multiply(N, block->Psi + r * N * N, A, product);
        memcpy(A, product, N * N * sizeof(double));
    }
}

/* The scores of each of `count` rows from the rest of its block and the beginning of the next one, where there is one. */
static void to_lag(const Block *block, size_t N, size_t count, int has_next, double *work, double *of_state, double *of_variance)
{
    double *A = work + 2 * N * N, *product = A + N * N;
    memset(A, 0, N * N * sizeof(double));
    for (size_t i = 0; i < N; i++) A[i * N + i] = 1.0;
    for (size_t r = count; r-- > 0;) {
        const double *Psi = block->Psi + r * N * N;
        double *score = block->score + r * N, *variance = block->variance + r * N * N; /* become those of the rest */
        if (r + 1 < count) {
            add_turned(N, score, Psi, score + N);
            add_congruent(N, Psi, variance + N * N, work, variance);
            mirror(N, variance);
        }
        memcpy(of_state + r * N, score, N * sizeof(double));
        memcpy(of_variance + r * N * N, variance, N * N * sizeof(double));
        if (!has_next) continue;
        multiply(N, A, Psi, product);
        memcpy(A, product, N * N * sizeof(double));
        add_turned(N, of_state + r * N, A, block->next + r * N);
        add_congruent(N, A, block->next_variance + r * N * N, work, of_variance + r * N * N);
        mirror(N, of_variance + r * N * N);
    }
}

/* `lagged_adjoint`: scores (K,N) and variances (K,N,N) at each row of one record from its own samples and those of L − 1
   more rows. */
SHARED int ndob_lagged(const Record *r, const Filtered *found, size_t L, double *of_state, double *of_variance)
{
    size_t N = r->N, each = N * N + N;
    Loop loop;
    double *memory = new_loop(&loop, N, r->p), *work = malloc((4 * N * N + L * (N * N + 3 * each)) * sizeof(double));
    int good = memory && work;
    if (good) {
        Block block = {.Psi = work + 4 * N * N};
        block.score = block.Psi + L * N * N;
        block.variance = block.score + L * N;
        block.first = block.variance + L * N * N;
        block.first_variance = block.first + L * N;
        block.next = block.first_variance + L * N * N;
        block.next_variance = block.next + L * N;
        for (size_t first = (r->K - 1) / L * L, has_next = 0;; first -= L, has_next = 1) {
            size_t count = r->K - first < L ? r->K - first : L;
            for (size_t i = 0; i < count; i++) {
                loop_at(&loop, r, found, first + i, 0, block.score + i * N, block.variance + i * N * N);
                memcpy(block.Psi + i * N * N, loop.Psi, N * N * sizeof(double));
            }
            from_first(&block, N, L, count, work);
            to_lag(&block, N, count, (int)has_next, work, of_state + first * N, of_variance + first * N * N);
            double *score = block.next, *variance = block.next_variance;
            block.next = block.first, block.next_variance = block.first_variance;
            block.first = score, block.first_variance = variance;
            if (!first) break;
        }
    }
    free(memory);
    free(work);
    return good;
}
