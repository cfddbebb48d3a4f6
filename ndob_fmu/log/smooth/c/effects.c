/* `event_effects.AlongRecord`: what events do to the scores along a filtered record, with the same letters. */

/* E events of c columns at instants `at` (E,), with scores s_U (E,c) and W (E,c,c). x (E,N,c): the columns behind the first
   step forwards, G of the event's own row backwards.
   variances (K,N,N): Λ; goes_on (K,): 0 where no step follows
   They are followed over `most` rows at most, and no further where less than `forgotten` of the scores' variance changes
   in the second half of `rows`. */
typedef struct {
    size_t E, c, most, rows;
    double forgotten;
    const size_t *at;
    const double *x, *score, *weight, *variances, *goes_on;
} Events;

/* G (E,most,N,c), g (E,most,p,c), and of each event how many rows it changes (E,) */
typedef struct {
    double *of_state, *of_sample;
    size_t *reach;
} Effects;

/* Whether an event changes λ (N,) of variance Λ noticeably, or that variance. */
static int counts(const Events *events, size_t e, size_t N, const double *G, const double *variance)
{
    size_t c = events->c;
    const double *score = events->score + e * c, *weight = events->weight + e * c * c;
    for (size_t i = 0; i < N; i++) {
        double in_score = 0.0, in_variance = 0.0, least = events->forgotten * variance[i * N + i];
        for (size_t j = 0; j < c; j++) {
            double weighted = 0.0;
            for (size_t l = 0; l < c; l++) weighted += G[i * c + l] * weight[l * c + j];
            in_score += weighted * score[j];
            in_variance += weighted * G[i * c + j];
        }
        if (in_score * in_score > least || fabs(in_variance) > least) return 1;
    }
    return 0;
}

/* to (n,c) += A B, for A (n,N) and B (N,c) */
static void add_product(size_t n, size_t N, size_t c, const double *A, const double *B, double *to)
{
    for (size_t i = 0; i < n; i++)
        for (size_t l = 0; l < N; l++) add(c, to + i * c, A[i * N + l], B + l * c);
}

/* G and g at a row after the event's. state (N,c): the event's columns there; next (N,c): behind its step, with G at the
   row there. */
static void effect_after(const Loop *loop, size_t N, size_t p, size_t c, const double *alpha, const double *state,
                         const double *next_G, double *shown, double *g)
{
    memset(shown, 0, p * c * sizeof(double));
    memset(g, 0, p * c * sizeof(double));
    add_product(p, N, c, loop->H, state, shown);
    add_product(p, N, c, loop->later, next_G, g);
    for (size_t i = 0; i < p; i++)
        for (size_t j = 0; j <= i; j++) add(c, g + j * c, loop->W[i * p + j] / alpha[i], shown + i * c);
}

static void follow(const Record *r, const Filtered *found, const Events *events, int way, size_t e, const Loop *loop,
                   double *work, const double *no_step, const Effects *to)
{
    size_t N = r->N, p = r->p, c = events->c, reach = 0, k = events->at[e];
    double *state = work, *next = state + N * c, *next_G = next + N * c, *shown = next_G + N * c;
    memcpy(state, events->x + e * N * c, N * c * sizeof(double));
    for (size_t done = 0; done < events->most; done++) {
        if (way > 0 ? ++k >= r->K : k-- == 0) break;
        double *G = to->of_state + (e * events->most + done) * N * c, *g = to->of_sample + (e * events->most + done) * p * c;
        const double *Phi = events->goes_on[k] != 0.0 ? r->Phi + k * N * N : no_step;
        close_loop(loop, N, p, Phi, r->rows + k * p * N, found->gain + k * p * N);
        memset(next, 0, N * c * sizeof(double));
        if (way > 0) {
            if (!done) {
                memset(G, 0, N * c * sizeof(double));
                add_product(N, N, c, events->variances + k * N * N, state, G);
            } else {
                memcpy(G, next_G, N * c * sizeof(double));
            }
            memset(next_G, 0, N * c * sizeof(double));
            add_product(N, N, c, loop->Psi, state, next);
            if (k + 1 < r->K) add_product(N, N, c, events->variances + (k + 1) * N * N, next, next_G);
            effect_after(loop, N, p, c, found->alpha + k * p, state, next_G, shown, g);
        } else {
            for (size_t l = 0; l < N; l++)
                for (size_t i = 0; i < N; i++) add(c, next + i * c, loop->Psi[l * N + i], state + l * c);
            memcpy(G, next, N * c * sizeof(double));
            memset(g, 0, p * c * sizeof(double));
            add_product(p, N, c, loop->later, state, g);
        }
        memcpy(state, next, N * c * sizeof(double));
        if (counts(events, e, N, G, events->variances + k * N * N)) reach = done + 1;
        if ((done + 1) % events->rows == 0 && reach + events->rows / 2 <= done + 1) break;
    }
    to->reach[e] = reach;
}

SHARED int ndob_effects(const Record *r, const Filtered *found, const Events *events, int way, const Effects *to)
{
    size_t N = r->N, c = events->c;
    Loop loop;
    double *memory = new_loop(&loop, N, r->p), *work = malloc((3 * N + r->p) * c * sizeof(double));
    double *no_step = calloc(N * N, sizeof(double));
    int good = memory && work && no_step;
    for (size_t e = 0; good && e < events->E; e++) follow(r, found, events, way, e, &loop, work, no_step, to);
    free(memory);
    free(work);
    free(no_step);
    return good;
}
