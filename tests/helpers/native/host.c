/* A host that is no Python process: runs one FMU by commands on stdin, one a line, and prints a line for each.
 *
 *   host LIBRARY RESOURCE_URI GUID     an argument "-" is NULL
 *
 *   new [NAME] [GUID] [on]   instantiate into the next place, say "new OK" or "new NULL"
 *   at PLACE                 go on with the instance at that place (they count from 0)
 *   setup START STOP         enter  exit  terminate  reset  free
 *   setR|setI|setB REFS VALUES   getR|getI|getB REFS     lists with commas: 0,1 2.5,3
 *   setS REF TEXT            a text without spaces
 *   step TIME SIZE           last                        time of the last step
 *   run STEPS SIZE SETREFS GETREFS   steps from the time of the last run; prints the last outputs
 *   play TABLE STEPS SIZE SETREFS GETREFS BOOLREFS RESULT HOW
 *                            sets a row of the file TABLE before each step, and writes a row of outputs after each to the file RESULT;
 *                            both are tables of doubles. HOW: "here"; "moved", each step on a thread of its own; "crowd", all
 *                            instances at once, each on a thread; "odd", while the host rounds downward and flushes small numbers
 *                            to zero. Prints how many blocks of memory were asked for during the steps, if count_memory.c counts
 *   memory                   how many blocks of memory were asked for since this was asked last
 *   cost STEPS SETREFS GETREFS BOOLREFS   microseconds that getting and setting take, the least of ten tries
 *   threads STEPS            steps the instances at places 0 and 1 on two threads; prints their first outputs
 *   log ON CATEGORIES        save  restore  drop  bytes FILE  unbytes FILE      FMU state
 *   traps                    from now on a division by zero and their like end the process; prints whether they did already
 *   fork TIMES MODE          fork so often, at "rest" or while a thread makes "steps" with the instance at place 0, and have each
 *                            child get, step and free it and make another; prints how many were OK, refused and hung
 *   storm TIMES              two threads make instances, take and free states of their own, and free all
 *
 * Log messages are printed as "log STATUS CATEGORY TEXT". */
#define _GNU_SOURCE
#include "fmi2Functions.h"

#ifdef _WIN32
#include "windows.h"
#else
#include <dlfcn.h>
#include <sys/wait.h>
#include <unistd.h>
#endif
#include <fenv.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

/* A floating-point environment that no FMU expects: rounding downward, and numbers near zero become zero. Both return what
 * the processor's control registers say. environment_back() then brings back the usual one. */
static unsigned long control_word(void) {
#if defined(__x86_64__)
    unsigned short x87;
    __asm__ volatile("fnstcw %0" : "=m"(x87));
    return (unsigned long)(__builtin_ia32_stmxcsr() & ~0x3fu) << 16 | x87;
#elif defined(__aarch64__)
    unsigned long word;
    __asm__ volatile("mrs %0, fpcr" : "=r"(word));
    return word;
#else
    return (unsigned long)fegetround();
#endif
}

static unsigned long odd_environment(void) {
    fesetround(FE_DOWNWARD);
#if defined(__x86_64__)
    __builtin_ia32_ldmxcsr(__builtin_ia32_stmxcsr() | 0x8040u);
#elif defined(__aarch64__)
    __asm__ volatile("msr fpcr, %0" : : "r"(control_word() | 1ul << 24));
#endif
    return control_word();
}

static unsigned long environment_back(void) {
    unsigned long word = control_word();
    fesetenv(FE_DFL_ENV);
    return word;
}

static const char *const STATUS[] = {"OK", "Warning", "Discard", "Error", "Fatal", "Pending"};
static void *library;
#define CALL(name) ((fmi2##name##TYPE *)dlsym(library, "fmi2" #name))

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    va_list arguments;
    va_start(arguments, message);
    printf("log %s %s ", STATUS[status], category);
    vprintf(message, arguments);
    puts("");
    va_end(arguments);
    (void)environment, (void)name;
}

static size_t references(char *text, fmi2ValueReference *to) {
    size_t count = 0;
    for (char *one; text && strcmp(text, "-") != 0 && (one = strsep(&text, ","));) to[count++] = (unsigned)strtoul(one, NULL, 10);
    return count;
}

static size_t reals(char *text, double *to) {
    size_t count = 0;
    for (char *one; text && strcmp(text, "-") != 0 && (one = strsep(&text, ","));) to[count++] = strtod(one, NULL);
    return count;
}

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec * 1e6 + (double)t.tv_nsec * 1e-3;
}

static fmi2Component places[256], c;
static size_t made;
static int steps_of_threads;

static void *steps(void *instance) {
    for (int k = 0; k < steps_of_threads; k++)
        if (CALL(DoStep)(instance, k * 1e-3, 1e-3, fmi2True) != fmi2OK) puts("thread: step failed");
    return NULL;
}

/* -- a table of inputs, and one of outputs */

typedef struct {
    fmi2Component instance;
    long rows;
    size_t inputs, reals, flags;
    const fmi2ValueReference *set, *get, *get_flags;
    const double *table;
    double *result;
    double size, time;
    long next;
    fmi2Status status;
} Play;

static void play_row(Play *play) {
    long k = play->next;
    double *row = play->result + (size_t)k * (play->reals + play->flags);
    fmi2Boolean flags[256];
    fmi2Status all[] = {
        play->inputs ? CALL(SetReal)(play->instance, play->set, play->inputs, play->table + (size_t)k * play->inputs) : fmi2OK,
        CALL(DoStep)(play->instance, play->time, play->size, fmi2True),
        CALL(GetReal)(play->instance, play->get, play->reals, row),
        play->flags ? CALL(GetBoolean)(play->instance, play->get_flags, play->flags, flags) : fmi2OK,
    };
    for (size_t i = 0; i < play->flags; i++) row[play->reals + i] = flags[i];
    for (size_t i = 0; i < 4; i++)
        if (all[i] > play->status) play->status = all[i];
    play->next = k + 1;
    play->time = (double)play->next * play->size;
}

static void *play_one(void *play) { return play_row(play), NULL; }

static void *play_all(void *play) {
    for (Play *each = play; each->next < each->rows;) play_row(each);
    return NULL;
}

static unsigned long blocks_asked_for(void) {
    unsigned long (*counted)(void) = (unsigned long (*)(void))dlsym(RTLD_DEFAULT, "blocks_asked_for");
    return counted ? counted() : 0;
}

static void play(Play *plays, size_t count, const char *how) {
    pthread_t threads[256];
    unsigned long before = blocks_asked_for();
    if (strcmp(how, "crowd") == 0) {
        for (size_t i = 0; i < count; i++) pthread_create(&threads[i], NULL, play_all, &plays[i]);
        for (size_t i = 0; i < count; i++) pthread_join(threads[i], NULL);
    } else if (strcmp(how, "moved") == 0) {
        while (plays->next < plays->rows) pthread_create(threads, NULL, play_one, plays), pthread_join(threads[0], NULL);
    } else if (strcmp(how, "odd") == 0) {
        while (plays->next < plays->rows) {
            unsigned long odd = odd_environment();
            play_row(plays);
            if (environment_back() != odd) plays->status = fmi2Fatal;
            plays->time = (double)plays->next * plays->size; /* rounded as for the others */
        }
    } else play_all(plays);
    printf("%lu ", blocks_asked_for() - before);
}

static const char *guid_of_all, *uri_of_all;
static fmi2CallbackFunctions callbacks_of_all;

static void *storm(void *times) {
    for (int k = 0; k < *(int *)times; k++) {
        fmi2Component c = CALL(Instantiate)("storm", fmi2CoSimulation, guid_of_all, uri_of_all, &callbacks_of_all, 0, 0);
        fmi2FMUstate states[4] = {NULL};
        fmi2Status worst = c ? fmi2OK : fmi2Error;
        for (int i = 0; i < 4 && c; i++)
            if (CALL(GetFMUstate)(c, &states[i]) != fmi2OK) worst = fmi2Error;
        if (c && CALL(FreeFMUstate)(c, &states[k % 4]) != fmi2OK) worst = fmi2Error;
        if (c) CALL(FreeInstance)(c); /* and with it the other three */
        if (worst != fmi2OK) puts("storm: a call failed");
    }
    return NULL;
}

#ifndef _WIN32 /* has no fork */
static volatile int stepping;

static void *endless(void *instance) {
    for (int k = 0; stepping; k++) CALL(DoStep)(instance, k * 1e-3, 1e-3, fmi2True);
    return NULL;
}

/* 0 if the instance at place 0 and a new one work, 1 if the instance is refused, 2 if only some of its calls are, or the new one alone.
 * A fork at the edge of a call, when Python is not running, leaves a child in which a new instance works and the old one does not. */
static int child(void) {
    double value = 0.0;
    fmi2ValueReference reference = 0;
    int inherited = CALL(GetReal)(places[0], &reference, 1, &value) == fmi2OK;
    fmi2Real time = 0.0; /* the fork may fall between two steps of the thread */
    if (inherited) CALL(GetRealStatus)(places[0], fmi2LastSuccessfulTime, &time);
    inherited += CALL(DoStep)(places[0], time, 1e-3, fmi2True) == fmi2OK;
    CALL(FreeInstance)(places[0]);
    fmi2Component another =
        CALL(Instantiate)("child", fmi2CoSimulation, guid_of_all, uri_of_all, &callbacks_of_all, 0, 0);
    int made_one = another && CALL(GetReal)(another, &reference, 1, &value) == fmi2OK;
    if (another) CALL(FreeInstance)(another);
    return inherited == 0 ? 1 : inherited == 2 && made_one ? 0 : 2;
}

static void forks(int times, int steps) {
    int ends[3] = {0};
    pthread_t thread;
    if ((stepping = steps)) pthread_create(&thread, NULL, endless, places[0]);
    for (int i = 0; i < times; i++) {
        usleep(5000);
        pid_t process = fork();
        if (!process) {
            alarm(20); /* ends a child that hangs */
            /* Without exit(), which runs destructors that were never meant for a child of a process with threads:
             * that of NumPy 2.1.3's libgfortran closes its units and aborts. stdout has no buffer. */
            _exit(child());
        }
        int status = 0;
        waitpid(process, &status, 0);
        if (WIFEXITED(status)) ends[WEXITSTATUS(status) % 3]++;
    }
    if (steps) stepping = 0, pthread_join(thread, NULL);
    printf("OK %d refused %d hung %d ", ends[0], ends[1], times - ends[0] - ends[1] - ends[2]);
}

#endif

int main(int count, char *words[]) {
#ifdef _WIN32
    words = utf8_words(&count);
#endif
    if (count != 4 || !(library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL))) return fprintf(stderr, "%s\n", dlerror()), 2;
    const char *uri = strcmp(words[2], "-") ? words[2] : NULL;
    fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2ValueReference vr[256], vs[256], vb[256];
    double values[256];
    fmi2Integer integers[256];
    fmi2FMUstate state = NULL;
    double time = 0.0;
    static char bytes[1 << 20];
    setvbuf(stdout, NULL, _IONBF, 0);
    for (char line[8192]; fgets(line, sizeof line, stdin);) {
        char *word[9] = {0}, *rest = line;
        line[strcspn(line, "\n")] = '\0';
        for (int i = 0; i < 9 && rest; i++) word[i] = strsep(&rest, " ");
        const char *verb = word[0];
        fmi2Status status = fmi2OK;
#define IS(name) (strcmp(verb, name) == 0)
        if (IS("new")) {
            const char *guid = word[2] && strcmp(word[2], "-") ? word[2] : words[3];
            c = CALL(Instantiate)(word[1], fmi2CoSimulation, guid, uri, &callbacks, fmi2False, word[3] != NULL);
            if (c) places[made++] = c;
            printf("new %s\n", c ? "OK" : "NULL");
            continue;
        }
        if (IS("traps")) {
            int before = feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
            printf("traps %s\n", before ? "on" : "off");
            continue;
        }
        if (IS("storm")) {
            guid_of_all = words[3], uri_of_all = uri, callbacks_of_all = callbacks;
            int times = atoi(word[1]);
            pthread_t one, other;
            pthread_create(&one, NULL, storm, &times), pthread_create(&other, NULL, storm, &times);
            pthread_join(one, NULL), pthread_join(other, NULL);
#ifndef _WIN32
        } else if (IS("fork")) {
            guid_of_all = words[3], uri_of_all = uri, callbacks_of_all = callbacks;
            forks(atoi(word[1]), strcmp(word[2], "steps") == 0);
#endif
        } else if (IS("at")) c = places[atoi(word[1])];
        else if (IS("setup")) status = CALL(SetupExperiment)(c, 0, 0.0, atof(word[1]), word[2] != NULL, word[2] ? atof(word[2]) : 0.0);
        else if (IS("enter")) status = CALL(EnterInitializationMode)(c);
        else if (IS("exit")) status = CALL(ExitInitializationMode)(c);
        else if (IS("terminate")) status = CALL(Terminate)(c);
        else if (IS("reset")) status = CALL(Reset)(c);
        else if (IS("free")) CALL(FreeInstance)(c);
        else if (IS("step")) status = CALL(DoStep)(c, atof(word[1]), atof(word[2]), fmi2True);
        else if (IS("last")) status = CALL(GetRealStatus)(c, fmi2LastSuccessfulTime, values), printf("%.17g ", values[0]);
        else if (IS("setR")) reals(word[2], values), status = CALL(SetReal)(c, vr, references(word[1], vr), values);
        else if (IS("setS")) references(word[1], vr), status = CALL(SetString)(c, vr, 1, (const fmi2String *)&word[2]);
        else if (IS("setI") || IS("setB")) {
            size_t n = reals(word[2], values);
            for (size_t i = 0; i < n; i++) integers[i] = (int)values[i];
            status = (IS("setI") ? CALL(SetInteger) : CALL(SetBoolean))(c, vr, references(word[1], vr), integers);
        } else if (IS("getR") || IS("run")) {
            if (IS("run")) {
                size_t n = references(word[3], vs);
                double h = atof(word[2]);
                for (int k = 0; k < atoi(word[1]) && status == fmi2OK; k++) {
                    for (size_t i = 0; i < n; i++) values[i] = 0.25 * (double)(k % 7);
                    if (n) CALL(SetReal)(c, vs, n, values);
                    status = CALL(DoStep)(c, time + k * h, h, fmi2True);
                }
                time += atoi(word[1]) * h;
            }
            size_t n = references(IS("run") ? word[4] : word[1], vr);
            if (status == fmi2OK) status = CALL(GetReal)(c, vr, n, values);
            for (size_t i = 0; i < n && status == fmi2OK; i++) printf("%.17g ", values[i]);
        } else if (IS("getI") || IS("getB")) {
            size_t n = references(word[1], vr);
            status = (IS("getI") ? CALL(GetInteger) : CALL(GetBoolean))(c, vr, n, integers);
            for (size_t i = 0; i < n && status == fmi2OK; i++) printf("%d ", integers[i]);
        } else if (IS("play")) {
            Play plays[256] = {{c, atol(word[2]), references(word[4], vs), references(word[5], vr), references(word[6], vb),
                                vs, vr, vb, NULL, NULL, atof(word[3]), 0.0, 0, fmi2OK}};
            size_t used = strcmp(word[8], "crowd") == 0 ? made : 1, rows = (size_t)plays->rows;
            size_t cells = rows * (plays->reals + plays->flags);
            double *table = calloc(rows * plays->inputs + 1, sizeof *table), *result = calloc(used * cells + 1, sizeof *result);
            FILE *file = fopen(word[1], "rb");
            if (fread(table, sizeof *table, rows * plays->inputs, file) != rows * plays->inputs) puts("play: TABLE is too short");
            fclose(file);
            for (size_t i = used; i-- > 0;) {
                plays[i] = plays[0];
                plays[i].table = table, plays[i].result = result + i * cells;
                if (used > 1) plays[i].instance = places[i];
            }
            play(plays, used, word[8]);
            for (size_t i = 0; i < used; i++)
                if (plays[i].status > status) status = plays[i].status;
            file = fopen(word[7], "wb");
            fwrite(result, sizeof *result, used * cells, file);
            fclose(file), free(table), free(result);
        } else if (IS("memory")) {
            static unsigned long asked;
            printf("%lu ", blocks_asked_for() - asked);
            asked = blocks_asked_for();
        } else if (IS("cost")) {
            size_t n = references(word[2], vs), m = references(word[3], vr), b = references(word[4], vb);
            double least = 1e9;
            CALL(GetReal)(c, vs, n, values);
            fmi2SetRealTYPE *set = CALL(SetReal);
            fmi2GetRealTYPE *get = CALL(GetReal);
            fmi2GetBooleanTYPE *flags = CALL(GetBoolean);
            for (int i = 0; i < 10; i++) {
                double begin = now();
                for (int k = 0; k < atoi(word[1]); k++) set(c, vs, n, values), get(c, vr, m, values + n), flags(c, vb, b, integers);
                double taken = (now() - begin) / atoi(word[1]);
                if (taken < least) least = taken;
            }
            printf("%.3f ", least);
        } else if (IS("threads")) {
            pthread_t one, other;
            steps_of_threads = atoi(word[1]);
            pthread_create(&one, NULL, steps, places[0]), pthread_create(&other, NULL, steps, places[1]);
            pthread_join(one, NULL), pthread_join(other, NULL);
        } else if (IS("log")) {
            const char *categories[16];
            size_t n = 0;
            for (char *one; (one = strsep(&word[2], ","));) categories[n++] = one;
            status = CALL(SetDebugLogging)(c, atoi(word[1]), n, categories);
        } else if (IS("save")) status = CALL(GetFMUstate)(c, &state);
        else if (IS("restore")) status = CALL(SetFMUstate)(c, state);
        else if (IS("drop")) status = CALL(FreeFMUstate)(c, &state);
        else if (IS("bytes") || IS("unbytes")) {
            size_t size = 0;
            FILE *file = fopen(word[1], IS("bytes") ? "wb" : "rb");
            if (IS("bytes")) {
                status = CALL(SerializedFMUstateSize)(c, state, &size);
                if (status == fmi2OK) status = CALL(SerializeFMUstate)(c, state, bytes, size);
                if (status == fmi2OK) fwrite(bytes, 1, size, file);
            } else {
                size = fread(bytes, 1, sizeof bytes, file);
                status = CALL(DeSerializeFMUstate)(c, bytes, size, &state);
            }
            fclose(file);
        }
        printf("%s %s\n", verb, STATUS[status]);
    }
    return 0;
}
