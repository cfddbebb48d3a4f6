/* Ctrl-C in a Python host: Python raises KeyboardInterrupt in whatever runs in its main thread, and so does any other
 * signal handler that is written in Python and raises. In a slave that would end the instance and be lost to the host.
 * So signals that come during a call are held back to its end, and one that came just before is raised after it. */
#define _GNU_SOURCE
#include "python.h"

#include <signal.h>
#include <unistd.h>

static volatile sig_atomic_t inside, held[NSIG], any_held;
static volatile sig_atomic_t passed_on = 1; /* since the last call began */
static struct sigaction before[NSIG];
static bool holding[NSIG]; /* until it is restored: handlers that others set over this one pass signals on to it */
static bool holds_any;

static bool main_thread(void) {
    static __thread int known;
    if (!known) known = gettid() == getpid() ? 1 : 2;
    return known == 1;
}

static void on_signal(int number, siginfo_t *information, void *context) {
    passed_on = 1;
    if (inside) held[number] = any_held = 1;
    else if (before[number].sa_flags & SA_SIGINFO) before[number].sa_sigaction(number, information, context);
    else before[number].sa_handler(number);
}

void interrupts_hold_back(void) {
    struct sigaction pythons;
    if (!main_thread() || sigaction(SIGINT, NULL, &pythons) != 0) return;
    /* Python has one C function for all the signals that it has handlers for. */
    if (!(pythons.sa_flags & SA_SIGINFO) && (pythons.sa_handler == SIG_DFL || pythons.sa_handler == SIG_IGN)) return;
    for (int number = 1; number < NSIG; number++) {
        struct sigaction now;
        if (holding[number] || sigaction(number, NULL, &now) != 0 || now.sa_handler != pythons.sa_handler) continue;
        before[number] = now;
        now.sa_sigaction = on_signal;
        now.sa_flags |= SA_SIGINFO;
        holding[number] = holds_any = sigaction(number, &now, NULL) == 0;
    }
}

void interrupts_give_back(void) {
    if (!holds_any || !main_thread()) return;
    for (int number = 1; number < NSIG; number++) {
        struct sigaction now;
        if (!holding[number] || sigaction(number, NULL, &now) != 0 || now.sa_sigaction != on_signal) continue;
        holding[number] = sigaction(number, &before[number], NULL) != 0;
    }
}

void interrupts_begin(void) {
    if (!holds_any || !main_thread()) return;
    if (inside++ || !passed_on) return;
    passed_on = 0;
    python_take_pending();
}

void interrupts_end(void) {
    if (!inside || !main_thread() || --inside) return;
    python_raise_taken();
    if (!any_held) return;
    any_held = 0;
    for (int number = 1; number < NSIG; number++)
        if (held[number]) {
            held[number] = 0;
            raise(number);
        }
}
