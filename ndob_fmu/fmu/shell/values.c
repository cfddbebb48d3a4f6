/* Getting and setting: variables that exist, by the functions of their type, when FMI allows it. A refused call changes
 * nothing. */
#include "core.h"

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

typedef struct {
    char letter;
    unsigned modes; /* in which it may be set */
    const char *expected, *received; /* where it may not */
} Role;

#define F(letter, modes, expected, received) {letter, modes, expected, received},
static const Role roles[] = {ROLES(F)};
#undef F

static const Role *role_of(const Variable *variable) {
    const Role *role = roles;
    while (role->letter != variable->role) role++;
    return role;
}

static bool settable(Instance *self, const char *function, const fmi2ValueReference references[], size_t count) {
    for (size_t i = 0; i < count; i++) {
        const Variable *variable = &self->description.variables[references[i]];
        const Role *role = role_of(variable);
        if (role->modes & self->progress.mode) continue;
        log_line(&self->log, fmi2Error, "%s: %s: expected %s, received %s", function, variable->name, role->expected,
                 role->received);
        return false;
    }
    return true;
}

/* The core takes texts in UTF-8 only. */
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

#define ACCESS(Name, TYPE) \
    fmi2Status fmi2Get##Name(fmi2Component component, const fmi2ValueReference references[], size_t count, \
                             fmi2##Name values[]) { \
        Instance *self = ENTER(fmi2Get##Name); \
        if (!self) return fmi2Error; \
        if (!count) return leave(self, fmi2OK); \
        if (!present(self, __func__, references, count, values, TYPE)) return leave(self, fmi2Error); \
        return leave(self, judged(self, core.Get##Name(self->core, references, count, values))); \
    } \
    fmi2Status fmi2Set##Name(fmi2Component component, const fmi2ValueReference references[], size_t count, \
                             const fmi2##Name values[]) { \
        Instance *self = ENTER(fmi2Set##Name); \
        if (!self) return fmi2Error; \
        if (!count) return leave(self, fmi2OK); \
        if (!present(self, __func__, references, count, values, TYPE) || !settable(self, __func__, references, count) \
            || !texts(self, __func__, references, count, values, TYPE)) \
            return leave(self, fmi2Error); \
        return leave(self, judged(self, core.Set##Name(self->core, references, count, values))); \
    }

ACCESS(Real, 'R')
ACCESS(Integer, 'I')
ACCESS(Boolean, 'B')
ACCESS(String, 'S')
