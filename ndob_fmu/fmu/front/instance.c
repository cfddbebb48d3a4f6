/* Instances: made, led through FMI's modes, freed. */
#define _GNU_SOURCE
#include "front.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

Slave slave;
static _Atomic int living;
static Lock loading = UNLOCKED;

/* Before pythonfmu's static objects are destroyed, after which its own call of this frees one of them twice. */
static void finish(void) {
    if (slave.finalize && !python_is_orphaned()) slave.finalize();
    if (slave.library && !living && !python_is_orphaned()) library_close(slave.library);
    slave = (Slave){0};
    python_leave();
}

/* After Python is there: the binary takes its symbols from the process. */
static bool load_slave(char *reason, size_t size) {
    char said[1024] = "a binary without FMI's functions";
    lock_acquire(&loading);
    if (!slave.library) {
        Slave loaded = {.library = slave_library(said, sizeof said)};
        bool complete = loaded.library != NULL;
        if (complete) {
            loaded.finalize = (void (*)(void))library_symbol(loaded.library, "finalizePythonInterpreter");
#define F(name) \
    complete = complete && (loaded.name = (fmi2##name##TYPE *)library_symbol(loaded.library, "fmi2" #name));
            SLAVE_FUNCTIONS(F)
#undef F
        }
        if (complete) {
            slave = loaded;
            at_end(finish);
        } else {
            snprintf(reason, size, "expected pythonfmu's binary beside the FMU's, received %s", said);
        }
    }
    lock_release(&loading);
    return slave.library != NULL;
}

static void discard(Instance *self) {
    description_free(&self->description);
    slave_location_close(self->folder);
    free(self->log.name);
    free(self);
}

/* The last instance is gone. */
static void left_by_all(void) {
    interrupts_give_back();
    python_drop_thread();
}

/* Whether the GUID is right, a Python runs and pythonfmu's binary is loaded; else with a message. */
static bool usable(Instance *self, fmi2String guid) {
    char reason[4096], warning[4096];
    if (!guid || strcmp(guid, self->description.guid) != 0) {
        log_line(
            &self->log, fmi2Error,
            "fmi2Instantiate: fmuGUID: expected %s, received %s; likely cause: a modelDescription.xml of another build",
            self->description.guid, guid ? guid : "NULL");
        return false;
    }
    if (python_is_orphaned()) {
        log_line(&self->log, fmi2Error,
                 "fmi2Instantiate: expected a process that starts by itself, received one that was forked while a thread "
                 "was calling an FMU; fork before the first or between two calls, or use spawn or exec");
        return false;
    }
    if (!python_start(&self->description, reason, sizeof reason, warning, sizeof warning)) {
        log_line(
            &self->log, fmi2Error,
            "fmi2Instantiate: expected a Python of 3.10 or later with NumPy and a shared libpython, received none: %s; %s",
            reason,
            python_is_the_hosts() ? "install NumPy for the Python that the host runs in"
                                  : "set NDOB_FMU_PYTHON to the path of such a Python");
        return false;
    }
    if (*warning) log_line(&self->log, fmi2Warning, "fmi2Instantiate: %s", warning);
    if (!load_slave(reason, sizeof reason)) {
        log_line(&self->log, fmi2Error, "fmi2Instantiate: %s", reason);
        return false;
    }
    return true;
}

/* Have all that pythonfmu needs; return the location that it gets (malloc), or NULL with a message. */
static char *prepared(Instance *self, fmi2Type type, fmi2String guid, const char *location) {
    char reason[4096] = "";
    if (type != fmi2CoSimulation) {
        log_line(&self->log, fmi2Error, "fmi2Instantiate: expected fmi2CoSimulation, received %s",
                 type == fmi2ModelExchange ? "fmi2ModelExchange" : "an unknown type");
        return NULL;
    }
    char *folder = resources_folder(location, reason, sizeof reason);
    bool described = folder && description_read(&self->description, folder, reason, sizeof reason);
    if (!described) log_line(&self->log, fmi2Error, "fmi2Instantiate: %s", reason);
    char *found = described && usable(self, guid) ? slave_location(folder, &self->folder, reason, sizeof reason) : NULL;
    if (described && !found && *reason) log_line(&self->log, fmi2Error, "fmi2Instantiate: %s", reason);
    free(folder);
    return found;
}

/* Have pythonfmu make the slave; NULL, with a message, if it does not. */
static fmi2Component made(Instance *self, fmi2String name, const char *guid, const char *location, fmi2Boolean visible) {
    char said[OVERHEARD_SIZE] = "nothing";
    Surroundings host;
    surroundings_enter(&host);
    python_keep_thread();
    self->log.overheard = said;
    fmi2Component component =
        slave.Instantiate(name, fmi2CoSimulation, guid, location, &self->callbacks, visible, fmi2True);
    self->log.overheard = NULL;
    /* pythonfmu puts it first for good; by now all that the FMU carries is imported. */
    python_forget_path(location + strlen(FILE_SCHEME), self->folder >= 0);
    surroundings_leave(&host);
    if (!component)
        log_line(&self->log, fmi2Error,
                 "fmi2Instantiate: expected the code that the build put into %s, received code that does not run (%s); "
                 "likely cause: files that were changed or damaged",
                 location + strlen(FILE_SCHEME), said);
    return component;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    if (!functions) return NULL;
    Instance *self = calloc(1, sizeof *self);
    if (!self) return NULL;
    bool named = name && *name && is_utf8(name);
    self->folder = -1;
    self->log = (Log){.logger = functions->logger,
                      .environment = functions->componentEnvironment,
                      .name = strdup(named ? name : "unnamed"),
                      .on = logging != fmi2False,
                      .categories = ALL_CATEGORIES};
    self->callbacks =
        (fmi2CallbackFunctions){log_from_slave, functions->allocateMemory, functions->freeMemory, NULL, &self->log};
    self->progress = (Progress){.mode = INSTANTIATED};
    python_entered();
    char *slave_folder = NULL;
    void *handle = NULL;
    if (!named) {
        log_line(&self->log, fmi2Error, "fmi2Instantiate: instanceName: expected a name in UTF-8, received %s",
                 name ? (*name ? "other bytes" : "an empty string") : "NULL");
    } else if ((slave_folder = prepared(self, type, guid, location))) {
        if (!living && python_is_the_hosts()) interrupts_hold_back();
        self->slave = made(self, name, guid, slave_folder, visible);
        if (self->slave && !(handle = handle_new(&instances, self))) slave.FreeInstance(self->slave);
    }
    python_left();
    free(slave_folder);
    if (!handle) {
        if (!living) left_by_all();
        discard(self);
        return NULL;
    }
    living++;
    self->slot = handle_slot(&instances, handle);
    return handle;
}

void fmi2FreeInstance(fmi2Component component) {
    Instance *self = enter(component, __func__, ANY_MODE | LOST | ORPHANED);
    if (!self) return;
    Surroundings host = self->host;
    states_free(self);
    if (self->progress.mode != ORPHANED) slave.FreeInstance(self->slave);
    handle_free(&instances, self->slot);
    discard(self);
    surroundings_leave(&host);
    if (--living == 0) left_by_all();
}

static void orphan(Slot *slot) {
    Instance *self = slot->object;
    self->progress.mode = ORPHANED;
    atomic_flag_clear(&slot->busy);
}

static void orphan_if_busy(Slot *slot) {
    if (atomic_flag_test_and_set(&slot->busy)) orphan(slot);
    else atomic_flag_clear(&slot->busy);
}

void instances_after_fork(bool usable) {
    lock_renew(&loading);
    handles_each(&instances, usable ? orphan_if_busy : orphan);
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t count, const fmi2String names[]) {
    Instance *self = enter(component, __func__, ANY_MODE);
    if (!self) return fmi2Error;
    if (count && !names) {
        log_line(&self->log, fmi2Error, "%s: expected %zu categories, received NULL", __func__, count);
        return leave(self, fmi2Error);
    }
    const char *unknown = NULL;
    unsigned categories = count ? log_categories(count, names, &unknown) : ALL_CATEGORIES;
    self->log.on = on != fmi2False;
    self->log.categories = categories;
    if (!unknown) return leave(self, fmi2OK);
    log_line(&self->log, fmi2Warning, "%s: expected log categories of the model description, received %s", __func__,
             unknown);
    return leave(self, fmi2Warning);
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop) {
    Instance *self = enter(component, __func__, INSTANTIATED);
    if (!self) return fmi2Error;
    if (!stop_defined) stop = HUGE_VAL;
    if (!isfinite(start) || !(stop >= start)) {
        log_line(&self->log, fmi2Error, "%s: expected a finite start time and no stop time before it, received %g and %g",
                 __func__, start, stop);
        return leave(self, fmi2Error);
    }
    stop_defined = isfinite(stop); /* there are hosts that say "infinite" for "not defined" */
    fmi2Status status = judged(self, slave.SetupExperiment(self->slave, tolerance_defined, tolerance, start,
                                                           stop_defined, stop_defined ? stop : 0.0));
    if (status < fmi2Discard) self->progress = (Progress){INSTANTIATED, true, start};
    return leave(self, status);
}

/* Do what leads from one mode to another; if it fails the instance stays where it was. */
static fmi2Status change(Instance *self, fmi2Status (*function)(fmi2Component), Mode mode) {
    fmi2Status status = judged(self, function(self->slave));
    if (status < fmi2Discard) self->progress.mode = mode;
    return leave(self, status);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
    Instance *self = enter(component, __func__, INSTANTIATED);
    if (!self) return fmi2Error;
    if (!self->progress.has_experiment) {
        log_line(&self->log, fmi2Error, "%s: expected fmi2SetupExperiment before it, received none", __func__);
        return leave(self, fmi2Error);
    }
    return change(self, slave.EnterInitializationMode, INITIALIZATION);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
    Instance *self = enter(component, __func__, INITIALIZATION);
    return self ? change(self, slave.ExitInitializationMode, STEPPING) : fmi2Error;
}

fmi2Status fmi2Terminate(fmi2Component component) {
    Instance *self = enter(component, __func__, STEPPING);
    return self ? change(self, slave.Terminate, TERMINATED) : fmi2Error;
}

fmi2Status fmi2Reset(fmi2Component component) {
    Instance *self = enter(component, __func__, ANY_MODE);
    if (!self) return fmi2Error;
    fmi2Status status = judged(self, slave.Reset(self->slave));
    if (status < fmi2Discard) self->progress = (Progress){.mode = INSTANTIATED};
    return leave(self, status);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return "2.0"; }
