/* The floating-point environment of the host, kept during a call: hosts trap exceptions or flush small numbers to zero,
 * which changes bits. */
#include "shell.h"

#if defined(__SSE2__) && defined(__x86_64__)
#include <xmmintrin.h>

#define DEFAULT_CONTROL 0x1f80u
#define EXCEPTION_FLAGS 0x3fu

Environment environment_enter(void) {
    unsigned host = _mm_getcsr();
    if ((host & ~EXCEPTION_FLAGS) != DEFAULT_CONTROL) _mm_setcsr(DEFAULT_CONTROL);
    return host;
}

void environment_leave(Environment host) {
    if (_mm_getcsr() != host) _mm_setcsr(host);
}
#else
Environment environment_enter(void) {
    fenv_t host;
    fegetenv(&host);
    fesetenv(FE_DFL_ENV);
    return host;
}

void environment_leave(Environment host) { fesetenv(&host); }
#endif
