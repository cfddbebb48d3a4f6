/* `row_transition`, with the same letters. */

/* K steps H of N states: c channels, h held columns, parts of the step; terms of the series, with the noise's weights. */
typedef struct {
    size_t K, N, c, h, parts, terms;
    const double *F, *H, *channel, *held, *shares, *units, *weights;
} Steps;

/* Phi (K,N,N), noise (K,N,c,N), responses (K,N,parts,h) */
typedef struct {
    double *Phi, *noise, *responses;
} Transitions;

static const double RADIUS = 0.25;

/* Scratch: X, and what is multiplied (N,N); the series of a column (terms,N); noise (c,N,N). */
typedef struct {
    double *X, *power, *product, *Phi, *series, *noise;
} Scratch;

/* Into how many halves a step is cut until the series is good: X becomes F times what is left of the step. */
static int cut(const Steps *steps, const double *F, double H, double *X)
{
    size_t N = steps->N;
    double size = 0.0;
    for (size_t j = 0; j < N; j++) {
        double sum = 0.0;
        for (size_t i = 0; i < N; i++) sum += fabs(X[i * N + j] = F[i * N + j] * (steps->units[j] / steps->units[i]) * H);
        if (sum > size) size = sum;
    }
    int doublings = 0;
    for (; size > RADIUS && doublings < 64; size *= 0.5) doublings++;
    double part = ldexp(1.0, -doublings);
    for (size_t i = 0; i < N * N; i++) X[i] *= part;
    return doublings;
}

/* Phi = e^X, of small X */
static void exponential(const Steps *steps, const Scratch *work, double *Phi)
{
    size_t N = steps->N;
    double *power = work->power, *product = work->product;
    memset(power, 0, N * N * sizeof(double));
    for (size_t i = 0; i < N; i++) power[i * N + i] = 1.0;
    memcpy(Phi, power, N * N * sizeof(double));
    for (size_t k = 1; k < steps->terms; k++) {
        multiply(N, work->X, power, product);
        for (size_t i = 0; i < N * N; i++) Phi[i] += power[i] = product[i] / (double)k;
    }
}

/* X^k/k! g, k = 0, 1, …, of column `which` of g (N,count) */
static void series_of(const Steps *steps, const Scratch *work, const double *g, size_t count, size_t which)
{
    size_t N = steps->N;
    for (size_t j = 0; j < N; j++) work->series[j] = g[j * count + which] / steps->units[j];
    for (size_t k = 1; k < steps->terms; k++)
        for (size_t j = 0; j < N; j++)
            work->series[k * N + j] = dot(N, work->X + j * N, work->series + (k - 1) * N) / (double)k;
}

/* A factor (N,N) of the covariance that white noise through a column of the channel adds in a short step h */
static void short_noise(const Steps *steps, const Scratch *work, Columns *columns, size_t which, double h, double *noise)
{
    size_t N = steps->N, terms = steps->terms, count = terms > N ? terms : N;
    series_of(steps, work, steps->channel, steps->c, which);
    memset(columns->columns, 0, count * N * sizeof(double));
    for (size_t i = 0; i < terms; i++)
        for (size_t k = i; k < terms; k++)
            add(N, columns->columns + i * N, sqrt(h) * steps->weights[i * terms + k], work->series + k * N);
    for (size_t j = 0; j < N; j++) columns->ends[j] = count;
    make_triangular(columns);
    take_rows(columns, noise);
}

/* noise = the factor of [noise, Phi noise] */
static void join_halves(const Scratch *work, Columns *columns, const double *Phi, double *noise)
{
    size_t N = columns->N;
    put_rows(columns, noise);
    multiply(N, Phi, noise, work->product);
    add_columns(columns, N, work->product);
    make_triangular(columns);
    take_rows(columns, noise);
}

static void square(const Scratch *work, size_t N, double *Phi)
{
    multiply(N, Phi, Phi, work->product);
    memcpy(Phi, work->product, N * N * sizeof(double));
}

/* e^{F s H} of the held columns, of a step that is short */
static void short_responses(const Steps *steps, const Scratch *work, double *responses)
{
    size_t N = steps->N, h = steps->h;
    for (size_t i = 0; i < h; i++) {
        series_of(steps, work, steps->held, h, i);
        for (size_t part = 0; part < steps->parts; part++)
            for (size_t j = 0; j < N; j++) {
                double sum = 0.0;
                for (size_t k = steps->terms; k-- > 0;) sum = sum * steps->shares[part] + work->series[k * N + j];
                responses[(j * steps->parts + part) * h + i] = steps->units[j] * sum;
            }
    }
}

/* The same of a long one. */
static void long_responses(const Steps *steps, const Scratch *work, const double *F, double H, double *responses)
{
    size_t N = steps->N, h = steps->h;
    for (size_t part = 0; part < steps->parts; part++) {
        int doublings = cut(steps, F, steps->shares[part] * H, work->X);
        exponential(steps, work, work->Phi);
        while (doublings-- > 0) square(work, N, work->Phi);
        for (size_t j = 0; j < N; j++)
            for (size_t i = 0; i < h; i++) {
                double sum = 0.0;
                for (size_t l = 0; l < N; l++) sum += work->Phi[j * N + l] * steps->held[l * h + i] / steps->units[l];
                responses[(j * steps->parts + part) * h + i] = steps->units[j] * sum;
            }
    }
}

static void one_transition(const Steps *steps, const Scratch *work, Columns *columns, size_t k, const Transitions *to)
{
    size_t N = steps->N, c = steps->c;
    const double *F = steps->F + k * N * N, *units = steps->units;
    double *Phi = to->Phi + k * N * N, *noise = work->noise, H = steps->H[k];
    double *responses = to->responses + k * steps->parts * N * steps->h;
    int doublings = cut(steps, F, H, work->X);
    exponential(steps, work, Phi);
    for (size_t i = 0; i < c; i++) short_noise(steps, work, columns, i, ldexp(H, -doublings), noise + i * N * N);
    if (!doublings) short_responses(steps, work, responses);
    for (int half = 0; half < doublings; half++) {
        for (size_t i = 0; i < c; i++) join_halves(work, columns, Phi, noise + i * N * N);
        square(work, N, Phi);
    }
    if (doublings) long_responses(steps, work, F, H, responses);
    for (size_t j = 0; j < N; j++)
        for (size_t l = 0; l < N; l++) {
            Phi[j * N + l] *= units[j] / units[l];
            for (size_t i = 0; i < c; i++)
                to->noise[((k * N + j) * c + i) * N + l] = units[j] * noise[(i * N + j) * N + l];
        }
}

SHARED int ndob_transitions(const Steps *steps, const Transitions *to)
{
    size_t N = steps->N, terms = steps->terms;
    double *memory = malloc(((4 + steps->c) * N * N + terms * N) * sizeof(double));
    Scratch work = {memory, memory + N * N, memory + 2 * N * N, memory + 3 * N * N, memory + 4 * N * N,
                    memory + 4 * N * N + terms * N};
    Columns columns;
    int good = new_columns(&columns, N, terms > N ? terms : N) && memory;
    for (size_t k = 0; good && k < steps->K; k++) one_transition(steps, &work, &columns, k, to);
    free_columns(&columns);
    free(memory);
    return good;
}
