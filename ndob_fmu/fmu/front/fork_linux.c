/* fork(). The child has one thread, the one that forked. If another one had Python's lock, nobody will ever release it in
 * the child: whatever enters Python there waits for ever. So all that the child inherits is refused then; and what another
 * thread was calling is refused in any case, since it stays in the middle of that call. */
#include "front.h"

#include <pthread.h>

static void in_child(void) {
    bool usable = python_after_fork();
    handles_after_fork();
    states_after_fork();
    instances_after_fork(usable);
}

__attribute__((constructor)) static void listen(void) { pthread_atfork(NULL, NULL, in_child); }
