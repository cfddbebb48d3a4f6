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

/* Scratch: X; the series X^k/k! [I, g, held], k = 0, 1, … (terms,N,width); e^X and a product (N,N); noise (c,N,N); that of
   one column (terms,N); responses (N,h); ratios (N,N) of the units. */
typedef struct {
    size_t width;
    double *X, *series, *Phi, *product, *noise, *column, *sums, *ratios;
} Scratch;

/* Into how many halves a step is cut until the series is good: X becomes F times what is left of the step. */
static int cut(const Steps *steps, const Scratch *work, const double *F, double H)
{
    size_t N = steps->N;
    double *X = work->X;
    double size = 0.0;
    for (size_t j = 0; j < N; j++) {
        double sum = 0.0;
        for (size_t i = 0; i < N; i++) sum += fabs(X[i * N + j] = F[i * N + j] * work->ratios[j * N + i] * H);
        if (sum > size) size = sum;
    }
    int doublings = 0;
    for (; size > RADIUS && doublings < 64; size *= 0.5) doublings++;
    double part = ldexp(1.0, -doublings);
    for (size_t i = 0; i < N * N; i++) X[i] *= part;
    return doublings;
}

/* The series of a small X, and Phi = e^X. The first of its terms are there. */
static void sum_series(const Steps *steps, const Scratch *work, double *Phi)
{
    size_t N = steps->N, width = work->width;
    for (size_t j = 0; j < N; j++) memcpy(Phi + j * N, work->series + j * width, N * sizeof(double));
    for (size_t k = 1; k < steps->terms; k++) {
        double *next = work->series + k * N * width, *last = next - N * width, part = 1.0 / (double)k;
        memset(next, 0, N * width * sizeof(double));
        for (size_t j = 0; j < N; j++) {
            for (size_t l = 0; l < N; l++)
                if (work->X[j * N + l] != 0.0) add(width, next + j * width, part * work->X[j * N + l], last + l * width);
            add(N, Phi + j * N, 1.0, next + j * width);
        }
    }
}

/* A factor (N,N) of the covariance that white noise through a column of the channel adds in a short step h */
static void short_noise(const Steps *steps, const Scratch *work, Columns *columns, size_t which, double h, double *noise)
{
    size_t N = steps->N, terms = steps->terms, count = terms > N ? terms : N;
    for (size_t i = 0; i < terms * N; i++) work->column[i] = work->series[i * work->width + N + which];
    memset(columns->columns, 0, count * N * sizeof(double));
    for (size_t i = 0; i < terms; i++)
        for (size_t k = i; k < terms; k++)
            add(N, columns->columns + i * N, sqrt(h) * steps->weights[i * terms + k], work->column + k * N);
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

/* e^{F s H} of the held columns for a part s of the step, of a step that is short */
static void short_responses(const Steps *steps, const Scratch *work, double share)
{
    size_t N = steps->N, h = steps->h, held = N + steps->c;
    memset(work->sums, 0, N * h * sizeof(double));
    for (size_t k = steps->terms; k-- > 0;)
        for (size_t j = 0; j < N; j++) {
            const double *term = work->series + (k * N + j) * work->width + held;
            for (size_t i = 0; i < h; i++) work->sums[j * h + i] = work->sums[j * h + i] * share + term[i];
        }
}

/* The same of a long one. */
static void long_responses(const Steps *steps, const Scratch *work, const double *F, double H)
{
    size_t N = steps->N, h = steps->h, held = N + steps->c;
    int doublings = cut(steps, work, F, H);
    sum_series(steps, work, work->Phi);
    while (doublings-- > 0) square(work, N, work->Phi);
    memset(work->sums, 0, N * h * sizeof(double));
    for (size_t j = 0; j < N; j++)
        for (size_t l = 0; l < N; l++) add(h, work->sums + j * h, work->Phi[j * N + l], work->series + l * work->width + held);
}

static void put_responses(const Steps *steps, const Scratch *work, size_t part, double *responses)
{
    size_t h = steps->h;
    for (size_t j = 0; j < steps->N; j++)
        for (size_t i = 0; i < h; i++)
            responses[(j * steps->parts + part) * h + i] = steps->units[j] * work->sums[j * h + i];
}

static void one_transition(const Steps *steps, const Scratch *work, Columns *columns, size_t k, const Transitions *to)
{
    size_t N = steps->N, c = steps->c;
    const double *F = steps->F + k * N * N, *units = steps->units;
    double *Phi = to->Phi + k * N * N, *noise = work->noise, H = steps->H[k];
    double *responses = to->responses + k * steps->parts * N * steps->h;
    int doublings = cut(steps, work, F, H);
    sum_series(steps, work, Phi);
    for (size_t i = 0; i < c; i++) short_noise(steps, work, columns, i, ldexp(H, -doublings), noise + i * N * N);
    for (size_t part = 0; !doublings && part < steps->parts; part++) {
        short_responses(steps, work, steps->shares[part]);
        put_responses(steps, work, part, responses);
    }
    for (int half = 0; half < doublings; half++) {
        for (size_t i = 0; i < c; i++) join_halves(work, columns, Phi, noise + i * N * N);
        square(work, N, Phi);
    }
    for (size_t part = 0; doublings && part < steps->parts; part++) {
        long_responses(steps, work, F, steps->shares[part] * H);
        put_responses(steps, work, part, responses);
    }
    for (size_t j = 0; j < N; j++)
        for (size_t l = 0; l < N; l++) {
            Phi[j * N + l] *= work->ratios[j * N + l];
            for (size_t i = 0; i < c; i++)
                to->noise[((k * N + j) * c + i) * N + l] = units[j] * noise[(i * N + j) * N + l];
        }
}

SHARED int ndob_transitions(const Steps *steps, const Transitions *to)
{
    size_t N = steps->N, c = steps->c, h = steps->h, terms = steps->terms, width = N + c + h;
    double *memory = malloc(((4 + c) * N * N + terms * N * (width + 1) + N * h) * sizeof(double));
    Columns columns;
    int good = new_columns(&columns, N, terms > N ? terms : N) && memory;
    if (good) {
        Scratch work = {.width = width, .X = memory};
        work.Phi = work.X + N * N;
        work.product = work.Phi + N * N;
        work.ratios = work.product + N * N;
        work.noise = work.ratios + N * N;
        work.column = work.noise + c * N * N;
        work.series = work.column + terms * N;
        work.sums = work.series + terms * N * width;
        for (size_t i = 0; i < N * N; i++) work.ratios[i] = steps->units[i / N] / steps->units[i % N];
        for (size_t j = 0; j < N; j++) {
            double *row = work.series + j * width;
            for (size_t i = 0; i < N; i++) row[i] = i == j ? 1.0 : 0.0;
            for (size_t i = 0; i < c; i++) row[N + i] = steps->channel[j * c + i] / steps->units[j];
            for (size_t i = 0; i < h; i++) row[N + c + i] = steps->held[j * h + i] / steps->units[j];
        }
        for (size_t k = 0; k < steps->K; k++) one_transition(steps, &work, &columns, k, to);
    }
    free_columns(&columns);
    free(memory);
    return good;
}
