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

/* The closed loop at a row, with scratch; the letters of `closed_loop`. behind (p,N): Φ K; later (p,N): l; W, told (p,p): W and W/α */
typedef struct {
    double *Psi, *H, *W, *behind, *later, *product, *score, *variance;
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

/* u and D of the samples at a row. */
static void sample_scores(const Loop *loop, size_t N, size_t p, const double *e, const double *alpha, double *u, double *D)
{
    for (size_t j = 0; j < p; j++) {
        const double *later = loop->later + j * N;
        u[j] = dot(N, later, loop->score);
        D[j] = 0.0;
        for (size_t row = 0; row < N; row++) D[j] += later[row] * dot(N, loop->variance + row * N, later);
        for (size_t i = j; i < p; i++) {
            double W = loop->W[i * p + j];
            u[j] += W * e[i] / alpha[i];
            D[j] += W * W / alpha[i];
        }
    }
}

/* λ and Λ before the samples of a row, by those behind its step. */
static void before_samples(const Loop *loop, size_t N, size_t p, const double *e, const double *alpha)
{
    double *Psi = loop->Psi, *product = loop->product, *turned = product + N * N, *score = turned + N * N;
    memset(product, 0, N * N * sizeof(double));
    memset(score, 0, N * sizeof(double));
    for (size_t l = 0; l < N; l++)
        for (size_t i = 0; i < N; i++)
            if (Psi[l * N + i] != 0.0) add(N, product + i * N, Psi[l * N + i], loop->variance + l * N);
    for (size_t l = 0; l < N; l++) {
        add(N, score, loop->score[l], Psi + l * N);
        for (size_t i = 0; i < N; i++) turned[l * N + i] = product[i * N + l];
    }
    memset(loop->variance, 0, N * N * sizeof(double));
    for (size_t l = 0; l < N; l++)
        for (size_t i = 0; i < N; i++)
            if (Psi[l * N + i] != 0.0) add(N - i, loop->variance + i * N + i, Psi[l * N + i], turned + l * N + i);
    for (size_t sample = 0; sample < p; sample++) {
        const double *H = loop->H + sample * N;
        add(N, score, e[sample] / alpha[sample], H);
        for (size_t i = 0; i < N; i++)
            if (H[i] != 0.0) add(N - i, loop->variance + i * N + i, H[i] / alpha[sample], H + i);
    }
    for (size_t i = 0; i < N; i++)
        for (size_t l = 0; l < i; l++) loop->variance[i * N + l] = loop->variance[l * N + i];
    memcpy(loop->score, score, N * sizeof(double));
}

SHARED int ndob_backward(const Record *r, const Filtered *found, const Scores *to)
{
    size_t N = r->N, p = r->p;
    double *work = malloc((4 * N * N + 2 * N + 3 * p * N + p * p) * sizeof(double));
    if (!work) return 0;
    Loop loop = {.Psi = work, .product = work + N * N, .variance = work + 3 * N * N + N};
    loop.score = loop.variance + N * N;
    loop.H = loop.score + N;
    loop.behind = loop.H + p * N;
    loop.later = loop.behind + p * N;
    loop.W = loop.later + p * N;
    for (size_t s = 0; s < r->S; s++) {
        memset(loop.variance, 0, (N * N + N) * sizeof(double));
        for (size_t k = r->K; k-- > 0;) {
            size_t at = k * r->S + s, sample = at * p;
            const double *e = found->innovation + sample, *alpha = found->alpha + sample;
            const double *Phi = k + 1 < r->K ? r->Phi + at * N * N : NULL;
            close_loop(&loop, N, p, Phi, r->rows + sample * N, found->gain + sample * N);
            sample_scores(&loop, N, p, e, alpha, to->of_sample + sample, to->of_sample_variance + sample);
            before_samples(&loop, N, p, e, alpha);
            memcpy(to->of_state + at * N, loop.score, N * sizeof(double));
            memcpy(to->of_state_variance + at * N * N, loop.variance, N * N * sizeof(double));
        }
    }
    free(work);
    return 1;
}
