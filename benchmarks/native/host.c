/* A C host that measures FMUs in processor time.
 *
 *   host cycles SAMPLES INPUTS WARM_UP COUNT ROUNDS FMU...    FMUs in turns; prints the seconds of COUNT cycles, a line
 *                                                             for each round, a number for each FMU
 *   host instances SAMPLES INPUTS NUMBER FMU                  prints the seconds of each instance up to its first step,
 *                                                             and the bytes that all take, freed one after the other
 *
 * SAMPLES is a file of doubles, INPUTS of them before each step. An FMU is LIBRARY|GUID|RESOURCES|OUTPUTS, these by
 * value references with commas; its inputs have the first ones. A cycle sets all inputs, makes a step of 1 ms, and reads the outputs. */
#define _GNU_SOURCE
#include "fmi2Functions.h"

#include <dlfcn.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#define STEP 1e-3
#define MOST 64

typedef struct {
    fmi2InstantiateTYPE *instantiate;
    fmi2SetupExperimentTYPE *setup;
    fmi2EnterInitializationModeTYPE *enter;
    fmi2ExitInitializationModeTYPE *leave;
    fmi2SetRealTYPE *set;
    fmi2GetRealTYPE *get;
    fmi2DoStepTYPE *step;
    fmi2FreeInstanceTYPE *release;
    const char *guid, *resources;
    fmi2ValueReference outputs[MOST];
    size_t output_count;
    fmi2Component instance;
} Fmu;

static double *samples;
static size_t inputs;
static fmi2ValueReference input_references[MOST];

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    (void)environment, (void)status, (void)category;
    fprintf(stderr, "%s: %s\n", name, message);
}

static const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};

static double processor_time(void) {
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *function(void *library, const char *name) {
    void *found = library ? dlsym(library, name) : NULL;
    if (found) return found;
    fprintf(stderr, "%s\n", dlerror());
    exit(1);
}

static void load(char *text, Fmu *fmu) {
    void *library = dlopen(strsep(&text, "|"), RTLD_NOW | RTLD_LOCAL);
    fmu->instantiate = (fmi2InstantiateTYPE *)function(library, "fmi2Instantiate");
    fmu->setup = (fmi2SetupExperimentTYPE *)function(library, "fmi2SetupExperiment");
    fmu->enter = (fmi2EnterInitializationModeTYPE *)function(library, "fmi2EnterInitializationMode");
    fmu->leave = (fmi2ExitInitializationModeTYPE *)function(library, "fmi2ExitInitializationMode");
    fmu->set = (fmi2SetRealTYPE *)function(library, "fmi2SetReal");
    fmu->get = (fmi2GetRealTYPE *)function(library, "fmi2GetReal");
    fmu->step = (fmi2DoStepTYPE *)function(library, "fmi2DoStep");
    fmu->release = (fmi2FreeInstanceTYPE *)function(library, "fmi2FreeInstance");
    fmu->guid = strsep(&text, "|");
    fmu->resources = strsep(&text, "|");
    for (char *one; (one = strsep(&text, ",")) && fmu->output_count < MOST;)
        fmu->outputs[fmu->output_count++] = (fmi2ValueReference)strtoul(one, NULL, 10);
}

static void check(bool good, const char *what) {
    if (good) return;
    fprintf(stderr, "%s failed\n", what);
    exit(1);
}

static fmi2Component started(const Fmu *fmu) {
    fmi2Component c = fmu->instantiate("one", fmi2CoSimulation, fmu->guid, fmu->resources, &callbacks, fmi2False, fmi2False);
    check(c != NULL, "fmi2Instantiate");
    check(fmu->setup(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == fmi2OK, "fmi2SetupExperiment");
    check(fmu->enter(c) == fmi2OK, "fmi2EnterInitializationMode");
    check(fmu->set(c, input_references, inputs, samples) == fmi2OK, "fmi2SetReal");
    check(fmu->leave(c) == fmi2OK, "fmi2ExitInitializationMode");
    return c;
}

static void cycle(const Fmu *fmu, fmi2Component c, size_t k) {
    fmi2Real values[MOST];
    fmu->set(c, input_references, inputs, samples + k * inputs);
    check(fmu->step(c, (double)k * STEP, STEP, fmi2True) == fmi2OK, "fmi2DoStep");
    fmu->get(c, fmu->outputs, fmu->output_count, values);
}

static void cycles(size_t warm_up, size_t count, size_t rounds, int fmus, Fmu *fmu) {
    double *taken = calloc((size_t)fmus, sizeof(double));
    for (int i = 0; i < fmus; i++) {
        fmu[i].instance = started(&fmu[i]);
        for (size_t k = 0; k < warm_up; k++) cycle(&fmu[i], fmu[i].instance, k);
    }
    for (size_t round = 0; round < rounds; round++) {
        for (int turn = 0; turn < fmus; turn++) {
            int i = (turn + (int)round) % fmus;
            size_t first = warm_up + round * count;
            double begin = processor_time();
            for (size_t k = first; k < first + count; k++) cycle(&fmu[i], fmu[i].instance, k);
            taken[i] = processor_time() - begin;
        }
        for (int i = 0; i < fmus; i++) printf("%.9g%c", taken[i], i + 1 < fmus ? ' ' : '\n');
    }
    free(taken);
}

/* Bytes of memory of this process that are in use. */
static double resident(void) {
    long pages = 0;
    FILE *file = fopen("/proc/self/statm", "r");
    check(file && fscanf(file, "%*d %ld", &pages) == 1, "/proc/self/statm");
    fclose(file);
    return (double)pages * (double)sysconf(_SC_PAGESIZE);
}

static void instances(size_t number, const Fmu *fmu) {
    fmi2Component *all = calloc(number, sizeof *all);
    double before = resident();
    for (size_t i = 0; i < number; i++) {
        double begin = processor_time();
        all[i] = started(fmu);
        cycle(fmu, all[i], 0);
        printf("%.9g ", processor_time() - begin);
    }
    printf("\n%.0f\n", resident() - before);
    for (size_t i = 0; i < number; i++) fmu->release(all[i]);
    free(all);
}

int main(int argc, char **argv) {
    bool is_cycles = argc > 4 && strcmp(argv[1], "cycles") == 0;
    int first = is_cycles ? 7 : 5;
    check(argc > first && argc - first <= MOST, "reading the arguments");
    inputs = strtoul(argv[3], NULL, 10);
    for (unsigned i = 0; i < inputs; i++) input_references[i] = i;
    FILE *file = fopen(argv[2], "rb");
    check(file && fseek(file, 0, SEEK_END) == 0, "opening the samples");
    size_t bytes = (size_t)ftell(file);
    rewind(file);
    samples = malloc(bytes);
    check(samples && fread(samples, 1, bytes, file) == bytes, "reading the samples");
    fclose(file);
    Fmu *fmus = calloc((size_t)(argc - first), sizeof *fmus);
    for (int i = first; i < argc; i++) load(argv[i], &fmus[i - first]);
    if (is_cycles)
        cycles(strtoul(argv[4], NULL, 10), strtoul(argv[5], NULL, 10), strtoul(argv[6], NULL, 10), argc - first, fmus);
    else instances(strtoul(argv[4], NULL, 10), fmus);
    return 0;
}
