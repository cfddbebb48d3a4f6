/* `DisturbanceSource`: shows the disturbance at the end of each step; it remembers the time only.
 *
 * A profile is read when the parameters are fixed. Its rows are the only memory that is taken after instantiation. */
#include "fmu.h"
#include "translated.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>

enum { TONES = 256, NOISE = 6, PROFILE = 7, HELD = 2, MEMORY = 16 * TONES };

typedef struct {
    double time;
} State;

typedef struct {
    Generator generator;
    Noise noise;
    Profile profile;
    nd_array views[2]; /* of the numbers of noise or profile */
    double rates[TONES], phases[TONES];
    double *rows; /* times, then values, of the profile */
    int kind;
    nd_arena arena;
    double memory[MEMORY];
} Core;

/* -- a profile */

static bool refuse_profile(const Call *call, const char *row, const char *expected, const char *received,
                           const char *likely) {
    char where[2 * TEXT_SIZE] = "disturbance.profile";
    if (row) strcat(strcat(strcat(where, " "), call->texts[0]), row);
    say(call->instance, ERROR, where, expected, received, likely);
    return false;
}

static bool refuse_file(const Call *call, const char *reason) {
    char received[2 * TEXT_SIZE] = "'";
    strcat(strcat(strcat(received, call->texts[0]), "' ("), reason);
    strcat(received, ")");
    return refuse_profile(call, NULL, "the path of a CSV file with columns time and value", received,
                          "the path is relative to the folder in which the host runs; give it whole");
}

/* Return the whole file as text (malloc), or NULL with a message. */
static char *read_file(const Call *call) {
    FILE *file = fopen(call->texts[0], "rb");
    if (!file) return refuse_file(call, strerror(errno)), NULL;
    size_t used = 0, room = 1 << 14;
    char *text = malloc(room);
    while (text) {
        used += fread(text + used, 1, room - used - 1, file);
        if (used < room - 1) break;
        char *larger = realloc(text, room *= 2);
        if (!larger) free(text);
        text = larger;
    }
    bool unread = ferror(file) != 0;
    fclose(file);
    if (text) text[used] = '\0';
    if (text && !unread && strlen(text) == used && is_utf8(text)) return text;
    refuse_file(call, unread ? strerror(errno) : text ? "it is no text in UTF-8" : "there is no memory for it");
    free(text);
    return NULL;
}

/* Read the number of a cell, up to a comma or the end of the row, and go behind it; false where there is none. */
static bool read_cell(const char **text, double *number) {
    char cell[64], point[8];
    size_t used = 0;
    for (; **text && **text != ','; ++*text)
        if (!strchr(" \t\"", **text) && used < sizeof cell - 1) cell[used++] = **text;
    cell[used] = '\0';
    if (**text) ++*text;
    snprintf(point, sizeof point, "%.1f", 0.5); /* strtod goes by the locale of the host */
    for (char *c = cell; *c; c++)
        if (*c == '.') *c = point[1];
    char *end;
    *number = strtod(cell, &end);
    return used && !*end && finite_number(*number);
}

static bool read_row(const char *row, double *time, double *value) {
    return read_cell(&row, time) && read_cell(&row, value);
}

static bool is_blank(const char *row) { return row[strspn(row, " \t\",")] == '\0'; }

/* Return the next row, with its end set to 0, and go behind it. */
static char *next_row(char **rest) {
    char *row = *rest;
    row[strcspn(row, "\r\n")] == '\0' ? (*rest = row + strlen(row)) : (*rest = row + strcspn(row, "\r\n") + 1);
    row[strcspn(row, "\r\n")] = '\0';
    return row;
}

/* Read the profile into `core->rows`; false with a message where that cannot be done. */
static bool read_profile(const Call *call, Core *core) {
    char *text = read_file(call);
    if (!text) return false;
    size_t most = 1, count = 0, number = 0;
    for (const char *c = text; *c; c++) most += *c == '\n' || *c == '\r';
    free(core->rows);
    core->rows = malloc(2 * most * sizeof *core->rows);
    char *rest = strncmp(text, "\xef\xbb\xbf", 3) == 0 ? text + 3 : text, message[TEXT_SIZE];
    bool good = core->rows != NULL, first = true;
    while (good && *rest) {
        char *row = next_row(&rest);
        double time, value;
        if (is_blank(row)) continue;
        bool numbers_there = read_row(row, &time, &value);
        if (first && !numbers_there) {
            first = false;
            continue;
        }
        first = false;
        number++;
        if (!numbers_there) {
            nd_print(message, sizeof message, ", data row %d", (int)number);
            char received[TEXT_SIZE];
            nd_print(received, sizeof received, "'%.900s'", row);
            good = refuse_profile(call, message, "two finite numbers, time and value", received, "");
        } else if (count && !(time > core->rows[count - 1])) {
            nd_print(message, sizeof message, "%g after %g", time, core->rows[count - 1]);
            good = refuse_profile(call, "", "times that ascend", message, "");
        } else {
            core->rows[count] = time;
            core->rows[most + count++] = value;
        }
    }
    free(text);
    if (good && !count) good = refuse_profile(call, "", "at least one row", "none", "");
    if (good) {
        core->views[0] = nd_around((int)count, core->rows);
        core->views[1] = nd_around((int)count, core->rows + most);
        core->profile.times = &core->views[0];
        core->profile.values = &core->views[1];
    }
    return good;
}

static void end(void *memory) {
    Core *core = memory;
    free(core->rows);
    core->rows = NULL;
}

/* -- the signal */

static double signal_at(Core *core, double t) {
    if (core->kind == NOISE) return Noise___call__(&core->arena, &core->noise, t);
    if (core->kind == PROFILE) return Profile___call__(&core->arena, &core->profile, t);
    return Generator___call__(&core->arena, &core->generator, t);
}

static bool show_in_memory(const Job *job) {
    job->call->outputs[0] = signal_at(job->call->core, job->first);
    return true;
}

static bool draw_in_memory(const Job *job) {
    Core *core = job->call->core;
    const double *values = job->call->values;
    Noise noise = disturbance_source_noise(&core->arena, values[AT_disturbance_amplitude],
                                           values[AT_disturbance_frequency], values[AT_disturbance_start_time],
                                           (int)values[AT_disturbance_seed]);
    for (int i = 0; i < TONES; i++) {
        core->rates[i] = nd_at(noise.rates, i);
        core->phases[i] = nd_at(noise.phases, i);
    }
    core->views[0] = nd_around(TONES, core->rates);
    core->views[1] = nd_around(TONES, core->phases);
    noise.rates = &core->views[0];
    noise.phases = &core->views[1];
    core->noise = noise;
    return true;
}

static bool possible_in_memory(const Job *job) {
    Core *core = job->call->core;
    return times_same_time(&core->arena, ((State *)job->call->state)->time, job->second);
}

static bool start(const Call *call, double time) {
    Core *core = call->core;
    const double *values = call->values;
    Generator generator = {(int)values[AT_disturbance_kind], values[AT_disturbance_amplitude],
                           values[AT_disturbance_frequency], values[AT_disturbance_start_time]};
    core->kind = generator.kind;
    core->generator = generator;
    core->profile.held = values[AT_disturbance_interpolation] == HELD;
    core->profile.amplitude = generator.amplitude;
    core->profile.start_time = generator.start_time;
    ((State *)call->state)->time = time;
    if (core->kind == PROFILE) return read_profile(call, core);
    return core->kind != NOISE || IN_MEMORY(call, 0.0, 0.0, ERROR, draw_in_memory);
}

static bool show(const Call *call) {
    return IN_MEMORY(call, ((State *)call->state)->time, 0.0, ERROR, show_in_memory);
}

static bool step(const Call *call, double time, double step_size) {
    if (!IN_MEMORY(call, time + step_size, 0.0, DISCARD, show_in_memory)) return false;
    ((State *)call->state)->time = time + step_size;
    return true;
}

static bool possible(const Call *call, double begin, double now) {
    return IN_MEMORY(call, begin, now, ERROR, possible_in_memory);
}
