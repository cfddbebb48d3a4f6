/* The Pythons that may serve, in their order: the one that NDOB_FMU_PYTHON names, the one that built the FMU, the
 * system's. An interpreter is asked, in a process of its own, what it has; the building one's answers are on record. */
#define _GNU_SOURCE
#include "interpreters.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#define PROBE_SECONDS 30

static void set(char *to, const char *from) { snprintf(to, PATH_MAX, "%s", from); }

/* Prints version, the places of libpython, NumPy's parent folder and the executable, one each line. */
static const char QUESTION[] =
    "import sys\n"
    "sys.path[:] = filter(None, sys.path)\n"
    "import os, sysconfig\n"
    "from importlib.util import find_spec\n"
    "value = sysconfig.get_config_var\n"
    "folders = [value('LIBDIR'), os.path.join(sys.base_prefix, 'lib'), value('LIBPL')]\n"
    "names = [n for n in (value('INSTSONAME'), value('LDLIBRARY')) if n and '.so' in n]\n"
    "places = [os.path.join(f, n) for n in names for f in folders if f]\n"
    "numpy = find_spec('numpy')\n"
    "print(sys.version_info[0], sys.version_info[1], int(bool(value('Py_GIL_DISABLED'))))\n"
    "print(next(filter(os.path.exists, places), ''))\n"
    "print(os.path.dirname(os.path.dirname(numpy.origin)) if numpy and numpy.origin else '')\n"
    "print(sys.executable)\n";

static long milliseconds(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000L + now.tv_nsec / 1000000L;
}

/* Wait for the process to end, and end it at the deadline. */
static void end(pid_t child, long deadline) {
    for (;;) {
        pid_t ended = waitpid(child, NULL, WNOHANG);
        if (ended > 0 || (ended < 0 && errno != EINTR)) return;
        if (milliseconds() >= deadline) break;
        nanosleep(&(struct timespec){.tv_nsec = 2000000}, NULL);
    }
    kill(child, SIGKILL);
    while (waitpid(child, NULL, 0) < 0 && errno == EINTR) continue;
}

/* Run the interpreter and return how many bytes it printed, or -1. The host's streams and signals stay its own. */
static ssize_t ask(const char *executable, char *answer, size_t size) {
    int ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) return -1;
    posix_spawn_file_actions_t actions;
    posix_spawnattr_t attributes;
    posix_spawn_file_actions_init(&actions);
    posix_spawnattr_init(&attributes);
    posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
    posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
    sigset_t none, all;
    sigemptyset(&none);
    sigfillset(&all);
    posix_spawnattr_setsigmask(&attributes, &none);
    posix_spawnattr_setsigdefault(&attributes, &all);
    posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF);
    /* -E: what the host sets for another Python is not for this one. */
    char *arguments[] = {(char *)executable, "-E", "-X", "utf8", "-c", (char *)QUESTION, NULL};
    pid_t child = 0;
    bool running = posix_spawn(&child, executable, &actions, &attributes, arguments, environ) == 0;
    posix_spawn_file_actions_destroy(&actions);
    posix_spawnattr_destroy(&attributes);
    close(ends[1]);
    ssize_t got = running ? 0 : -1;
    long deadline = milliseconds() + PROBE_SECONDS * 1000L;
    while (running && (size_t)got < size - 1) {
        struct pollfd waiting = {ends[0], POLLIN, 0};
        long left = deadline - milliseconds();
        int events = left > 0 ? poll(&waiting, 1, (int)left) : 0;
        if (events < 0 && errno == EINTR) continue;
        ssize_t more = events > 0 ? read(ends[0], answer + got, size - 1 - (size_t)got) : -1;
        if (more < 0 && events > 0 && errno == EINTR) continue;
        if (more < 0) got = -1;
        if (more <= 0) break;
        got += more;
    }
    close(ends[0]);
    if (running) end(child, got < 0 ? 0 : deadline);
    answer[got < 0 ? 0 : got] = '\0';
    return got;
}

/* Fill in the candidate from what its executable answers; else give the reason. */
static bool probe(Candidate *candidate, const char *executable, Reasons *reasons) {
    char answer[4 * PATH_MAX];
    if (access(executable, X_OK) != 0) return add_reason(reasons, "%s cannot be run", executable), false;
    if (ask(executable, answer, sizeof answer) <= 0)
        return add_reason(reasons, "%s is no Python that runs", executable), false;
    char *rest = answer, *line[4];
    for (int i = 0; i < 4; i++)
        if (!(line[i] = strsep(&rest, "\n"))) line[i] = "";
    int major = 0, minor = 0, without_gil = 0;
    if (sscanf(line[0], "%d %d %d", &major, &minor, &without_gil) != 3)
        return add_reason(reasons, "%s is no Python that runs", executable), false;
    if (major != 3 || minor < OLDEST_MINOR || without_gil)
        return add_reason(reasons, "%s is Python %d.%d%s", executable, major, minor, without_gil ? " without GIL" : ""),
               false;
    if (!*line[2]) return add_reason(reasons, "%s has no NumPy", executable), false;
    candidate->minor = minor;
    if (*line[1]) set(candidate->library, line[1]);
    /* Built without a shared library: one of the same version that the loader knows serves as well. */
    else snprintf(candidate->library, PATH_MAX, "libpython3.%d.so.1.0", minor);
    set(candidate->packages, line[2]);
    set(candidate->executable, *line[3] ? line[3] : executable);
    return true;
}

bool candidate_from_variable(Candidate *candidate, Reasons *reasons) {
    const char *named = getenv(VARIABLE);
    const char *file = strrchr(named, '/') ? strrchr(named, '/') + 1 : named;
    if (access(named, R_OK) != 0) return add_reason(reasons, VARIABLE " names %s, which cannot be read", named), false;
    int minor = 0;
    if (strstr(file, ".so") == NULL) return probe(candidate, named, reasons);
    if (sscanf(file, "libpython3.%d", &minor) != 1)
        return add_reason(reasons, VARIABLE " names %s, neither a Python executable nor a libpython3.x.so", named),
               false;
    char executable[PATH_MAX];
    snprintf(executable, sizeof executable, "%.*s/../bin/python3.%d", (int)(file - named), named, minor);
    if (access(executable, X_OK) != 0) snprintf(executable, sizeof executable, "/usr/bin/python3.%d", minor);
    if (!probe(candidate, executable, reasons)) return false;
    set(candidate->library, named);
    return true;
}

bool candidate_from_build(Candidate *candidate, const Description *description, Reasons *reasons) {
    const char *parts[] = {description_value(description, "python"), description_value(description, "libpython"),
                           description_value(description, "packages")};
    for (size_t i = 0; i < 3; i++) {
        char path[PATH_MAX];
        snprintf(path, sizeof path, i == 2 ? "%s/numpy/__init__.py" : "%s", parts[i]);
        if (access(path, R_OK) != 0) {
            add_reason(reasons, "the Python that built the FMU is not here (%s)", *parts[i] ? path : "not recorded");
            return false;
        }
    }
    set(candidate->executable, parts[0]);
    set(candidate->library, parts[1]);
    set(candidate->packages, parts[2]);
    return true;
}

bool candidate_from_system(Candidate *candidate, Reasons *reasons) {
    const char *path = getenv("PATH");
    char folders[PATH_MAX], *rest = folders;
    char tried[2 * PATH_MAX] = ":"; /* each between two colons */
    snprintf(folders, sizeof folders, "%s", path ? path : "/usr/local/bin:/usr/bin");
    for (const char *folder; (folder = strsep(&rest, ":"));) {
        char executable[PATH_MAX + 16], listed[PATH_MAX + 18];
        if (*folder != '/') continue;
        snprintf(executable, sizeof executable, "%s/python3", folder);
        snprintf(listed, sizeof listed, ":%s:", executable);
        if (access(executable, X_OK) != 0 || strstr(tried, listed)) continue;
        if (probe(candidate, executable, reasons)) return true;
        strncat(tried, listed + 1, sizeof tried - strlen(tried) - 1);
    }
    if (!tried[1]) add_reason(reasons, "the system has no python3");
    return false;
}
