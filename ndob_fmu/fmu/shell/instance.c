/* Instances: made, led through FMI's modes, freed. */
#define _GNU_SOURCE
#include "core.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

_Atomic int living;

static void discard(Instance *self) {
    description_free(&self->description);
    core_release(self);
    free(self->log.name);
    free(self);
}

/* Have all that the core needs; return the folder of the resources (malloc), or NULL with a message. */
static char *prepared(Instance *self, fmi2Type type, fmi2String guid, const char *location) {
    char reason[4096] = "";
    Description *description = &self->description;
    if (type != fmi2CoSimulation) {
        log_line(&self->log, fmi2Error, "fmi2Instantiate: expected fmi2CoSimulation, received %s",
                 type == fmi2ModelExchange ? "fmi2ModelExchange" : "an unknown type");
        return NULL;
    }
    char *folder = resources_folder(location, reason, sizeof reason);
    if (!folder || !description_read(description, folder, reason, sizeof reason)
        || !core_files_good(description, folder, reason, sizeof reason)) {
        log_line(&self->log, fmi2Error, "fmi2Instantiate: %s", reason);
    } else if (!guid || strcmp(guid, description->guid) != 0) {
        log_line(
            &self->log, fmi2Error,
            "fmi2Instantiate: fmuGUID: expected %s, received %s; likely cause: a modelDescription.xml of another build",
            description->guid, guid ? guid : "NULL");
    } else if (core_start(description, &self->log)) {
        return folder;
    }
    free(folder);
    return NULL;
}

static fmi2Component made(Instance *self, fmi2String name, const char *folder, fmi2Boolean visible) {
    if (!living) core_first_instance();
    Surroundings host;
    surroundings_enter(&host);
    core_keep_thread();
    fmi2Component component = core_instantiate(self, name, folder, visible);
    surroundings_leave(&host);
    return component;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    if (!functions) return NULL;
    Instance *self = calloc(1, sizeof *self);
    if (!self) return NULL;
    bool named = name && *name && is_utf8(name);
    self->opened = -1;
    self->log = (Log){.logger = functions->logger,
                      .environment = functions->componentEnvironment,
                      .name = strdup(named ? name : "unnamed"),
                      .on = logging != fmi2False,
                      .categories = ALL_CATEGORIES};
    self->callbacks =
        (fmi2CallbackFunctions){log_from_core, functions->allocateMemory, functions->freeMemory, NULL, &self->log};
    self->progress = (Progress){.mode = INSTANTIATED};
    core_entered();
    char *folder = NULL;
    void *handle = NULL;
    if (!named) {
        log_line(&self->log, fmi2Error, "fmi2Instantiate: instanceName: expected a name in UTF-8, received %s",
                 name ? (*name ? "other bytes" : "an empty string") : "NULL");
    } else if ((folder = prepared(self, type, guid, location))) {
        self->core = made(self, name, folder, visible);
        if (self->core && !(handle = handle_new(&instances, self))) core.FreeInstance(self->core);
    }
    core_left();
    free(folder);
    if (!handle) {
        if (!living) core_last_instance();
        discard(self);
        return NULL;
    }
    living++;
    self->slot = handle_slot(&instances, handle);
    return handle;
}

void fmi2FreeInstance(fmi2Component component) {
    Instance *self = ENTER(fmi2FreeInstance);
    if (!self) return;
    Surroundings host = self->host;
    states_free(self);
    if (self->progress.mode != ORPHANED) core.FreeInstance(self->core);
    handle_free(&instances, self->slot);
    discard(self);
    surroundings_leave(&host);
    if (--living == 0) core_last_instance();
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
    handles_each(&instances, usable ? orphan_if_busy : orphan);
}

fmi2Status fmi2SetDebugLogging(fmi2Component component, fmi2Boolean on, size_t count, const fmi2String names[]) {
    Instance *self = ENTER(fmi2SetDebugLogging);
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
    Instance *self = ENTER(fmi2SetupExperiment);
    if (!self) return fmi2Error;
    if (!stop_defined) stop = HUGE_VAL;
    if (!isfinite(start) || !(stop >= start)) {
        log_line(&self->log, fmi2Error, "%s: expected a finite start time and no stop time before it, received %g and %g",
                 __func__, start, stop);
        return leave(self, fmi2Error);
    }
    stop_defined = isfinite(stop); /* there are hosts that say "infinite" for "not defined" */
    fmi2Status status = judged(self, core.SetupExperiment(self->core, tolerance_defined, tolerance, start,
                                                           stop_defined, stop_defined ? stop : 0.0));
    if (status < fmi2Discard) self->progress = (Progress){INSTANTIATED, true, start};
    return leave(self, status);
}

/* Do what leads from one mode to another; if it fails the instance stays where it was. */
static fmi2Status change(Instance *self, fmi2Status (*function)(fmi2Component), Mode mode) {
    fmi2Status status = judged(self, function(self->core));
    if (status < fmi2Discard) self->progress.mode = mode;
    return leave(self, status);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component) {
    Instance *self = ENTER(fmi2EnterInitializationMode);
    if (!self) return fmi2Error;
    if (!self->progress.has_experiment) {
        log_line(&self->log, fmi2Error, "%s: expected fmi2SetupExperiment before it, received none", __func__);
        return leave(self, fmi2Error);
    }
    return change(self, core.EnterInitializationMode, INITIALIZATION);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component) {
    Instance *self = ENTER(fmi2ExitInitializationMode);
    return self ? change(self, core.ExitInitializationMode, STEPPING) : fmi2Error;
}

fmi2Status fmi2Terminate(fmi2Component component) {
    Instance *self = ENTER(fmi2Terminate);
    return self ? change(self, core.Terminate, TERMINATED) : fmi2Error;
}

fmi2Status fmi2Reset(fmi2Component component) {
    Instance *self = ENTER(fmi2Reset);
    if (!self) return fmi2Error;
    fmi2Status status = judged(self, core.Reset(self->core));
    if (status < fmi2Discard) self->progress = (Progress){.mode = INSTANTIATED};
    return leave(self, status);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return "2.0"; }
