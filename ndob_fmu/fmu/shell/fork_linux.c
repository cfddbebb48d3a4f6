/* fork(). The child has one thread, the one that forked. A lock of the core that another thread held is never released in
 * the child, and entering the core there would wait without end: then all instances that the child inherits are refused.
 * An instance that another thread was calling is refused in any case, since it stays in the middle of that call. */
#include "core.h"

#include <pthread.h>

static void in_child(void) {
    bool usable = core_after_fork();
    handles_after_fork();
    states_after_fork();
    instances_after_fork(usable);
}

__attribute__((constructor)) static void listen(void) { pthread_atfork(NULL, NULL, in_child); }
