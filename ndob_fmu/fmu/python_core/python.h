/* The process's Python, and the signals that it handles, as core.c uses them. */
#ifndef NDOB_PYTHON_H
#define NDOB_PYTHON_H

#include "../shell/core.h"

/* Have a running Python with NumPy in the process; else false with one line of reasons. `warning` gets what the user
 * should know although all is well, or stays empty. */
bool python_start(const Description *description, char *reason, size_t size, char *warning, size_t warning_size);
bool python_alive(void);
/* Around what may wait for Python's lock or have it. */
void python_entered(void);
void python_left(void);
/* In the child of a fork: whether Python can be entered there. */
bool python_after_fork(void);
/* Whether it cannot, since a fork in this process or one of its parents. */
bool python_is_orphaned(void);
/* Whether the process had a Python of its own before the first of these FMUs. */
bool python_is_the_hosts(void);
/* Keep the calling thread's thread state from now on, instead of a new one for each call. */
void python_keep_thread(void);
void python_drop_thread(void);
/* Whether Python gets from the folder's name in UTF-8 back to the same bytes, with which it opens files there. */
bool python_finds(const char *folder);
/* Take a folder from Python's path again; `reused` says that others may have its name later. */
void python_forget_path(const char *folder, bool reused);
/* Have Python handle the signals that it has noted, and keep what the handlers raise; have it raised in the host. */
void python_take_pending(void);
void python_raise_taken(void);
void python_leave(void);

/* -- interrupts_linux.c, python_windows.c */

void interrupts_hold_back(void); /* from now on, where Python handles them, during calls on the main thread */
void interrupts_give_back(void);
void interrupts_begin(void); /* of a call */
void interrupts_end(void);

#endif
