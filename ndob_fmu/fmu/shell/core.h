/* What the shell needs of a core, the part of an FMU's library that computes. python_core/ is one: pythonfmu's binary with
 * a Python to run in. Another core, in C, needs no change here. */
#ifndef NDOB_CORE_H
#define NDOB_CORE_H

#include "shell.h"

/* The calls that the shell hands on once they are allowed. `core` is filled in when core_start has returned true. */
#define CORE_FUNCTIONS(F) \
    F(FreeInstance) F(SetupExperiment) F(EnterInitializationMode) F(ExitInitializationMode) F(Terminate) F(Reset) \
        F(GetReal) F(GetInteger) F(GetBoolean) F(GetString) F(SetReal) F(SetInteger) F(SetBoolean) F(SetString) \
            F(GetFMUstate) F(SetFMUstate) F(FreeFMUstate) F(SerializedFMUstateSize) F(SerializeFMUstate) \
                F(DeSerializeFMUstate) F(DoStep)

typedef struct {
#define F(name) fmi2##name##TYPE *name;
    CORE_FUNCTIONS(F)
#undef F
} Core;

extern Core core;

/* Whether the core's files in the resources are as the build left them; else with the reason. */
bool core_files_good(const Description *description, const char *folder, char *reason, size_t size);
/* Prepare the process for instances; else false, with a message in the log. */
bool core_start(const Description *description, Log *log);
/* Before the first instance of this FMU is made, and after the last one is freed. */
void core_first_instance(void);
void core_last_instance(void);
/* Make an instance; NULL, with a message in the log, if that fails. `folder` holds the resources. */
fmi2Component core_instantiate(Instance *self, fmi2String name, const char *folder, fmi2Boolean visible);
/* Release what core_instantiate has kept in the Instance. */
void core_release(Instance *self);

/* Whether instances can be called still. */
bool core_alive(void);
/* Around everything that may enter the core. */
void core_entered(void);
void core_left(void);
/* Around each call of a host: no interrupt may end an instance in the middle of it. */
void core_hold_interrupts(void);
void core_release_interrupts(void);
/* Keep what the calling thread needs to enter the core until it ends or the last instance is freed. */
void core_keep_thread(void);
/* In the child of a fork: whether the core can be entered there. */
bool core_after_fork(void);

#endif
