/* Getting and setting: only what there is, of its own type, and when FMI allows it. Refused calls change nothing. */
#include "front.h"

static const char *type_name(char type) {
    return type == 'R' ? "Real" : type == 'I' ? "Integer" : type == 'B' ? "Boolean" : "String";
}

static bool present(Instance *self, const char *function, const fmi2ValueReference references[], size_t count,
                    const void *values, char type) {
    const Description *description = &self->description;
    if (!references || !values) {
        log_line(&self->log, fmi2Error, "%s: expected %zu %s, received NULL", function, count,
                 references ? "values" : "value references");
        return false;
    }
    for (size_t i = 0; i < count; i++) {
        fmi2ValueReference reference = references[i];
        if (reference >= description->count) {
            log_line(&self->log, fmi2Error, "%s: expected value references from 0 to %zu, received %u", function,
                     description->count - 1, reference);
            return false;
        }
        const Variable *variable = &description->variables[reference];
        if (variable->type != type) {
            log_line(&self->log, fmi2Error,
                     "%s: expected value references of %s variables, received %u, which is %s, %s", function,
                     type_name(type), reference, variable->name, type_name(variable->type));
            return false;
        }
    }
    return true;
}

static bool settable(Instance *self, const char *function, const fmi2ValueReference references[], size_t count) {
    bool stepping = self->progress.mode == STEPPING;
    for (size_t i = 0; i < count; i++) {
        const Variable *variable = &self->description.variables[references[i]];
        if (variable->role == 'o') {
            log_line(&self->log, fmi2Error,
                     "%s: %s: expected an input or a parameter, received what the FMU calculates", function,
                     variable->name);
            return false;
        }
        if (stepping && variable->role == 'f') {
            log_line(&self->log, fmi2Error,
                     "%s: %s: expected a fixed parameter's value before the end of initialization, received one in "
                     "step mode",
                     function, variable->name);
            return false;
        }
    }
    return true;
}

/* What pythonfmu can hand to Python: texts that are there and in UTF-8. */
static bool texts(Instance *self, const char *function, const fmi2ValueReference references[], size_t count,
                  const void *values, char type) {
    const fmi2String *strings = values;
    for (size_t i = 0; type == 'S' && i < count; i++) {
        if (strings[i] && is_utf8(strings[i])) continue;
        log_line(&self->log, fmi2Error, "%s: %s: expected a text in UTF-8, received %s", function,
                 self->description.variables[references[i]].name, strings[i] ? "other bytes" : "NULL");
        return false;
    }
    return true;
}

#define SETTABLE_MODES ((unsigned)(INSTANTIATED | INITIALIZATION | STEPPING))

#define ACCESS(Name, TYPE) \
    fmi2Status fmi2Get##Name(fmi2Component component, const fmi2ValueReference references[], size_t count, \
                             fmi2##Name values[]) { \
        Instance *self = enter(component, __func__, ANY_MODE); \
        if (!self) return fmi2Error; \
        if (!count) return leave(self, fmi2OK); \
        if (!present(self, __func__, references, count, values, TYPE)) return leave(self, fmi2Error); \
        return leave(self, judged(self, slave.Get##Name(self->slave, references, count, values))); \
    } \
    fmi2Status fmi2Set##Name(fmi2Component component, const fmi2ValueReference references[], size_t count, \
                             const fmi2##Name values[]) { \
        Instance *self = enter(component, __func__, SETTABLE_MODES); \
        if (!self) return fmi2Error; \
        if (!count) return leave(self, fmi2OK); \
        if (!present(self, __func__, references, count, values, TYPE) || !settable(self, __func__, references, count) \
            || !texts(self, __func__, references, count, values, TYPE)) \
            return leave(self, fmi2Error); \
        return leave(self, judged(self, slave.Set##Name(self->slave, references, count, values))); \
    }

ACCESS(Real, 'R')
ACCESS(Integer, 'I')
ACCESS(Boolean, 'B')
ACCESS(String, 'S')
