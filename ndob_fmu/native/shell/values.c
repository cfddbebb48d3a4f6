/* Values: of variables that exist, by the functions of their type, when FMI allows it. A refused call changes nothing. */
#include "shell.h"

#include <math.h>
#include <string.h>

static void append_count(char *line, size_t size, double count) {
    char number[NUMBER_SIZE];
    number_text(count, number);
    char *point = strchr(number, '.');
    if (point) *point = '\0';
    append(line, size, number);
}

static bool is_accessed_as(uint32_t reference, char type) {
    if (reference >= fmu.count) return false;
    char own = fmu.variables[reference].type;
    return own == type || accessed_as(own) == type;
}

static void say_unreadable(Instance *self, const char *function, uint32_t reference, char type) {
    char expected[160] = "", received[400] = "";
    append_count(received, sizeof received, (double)reference);
    if (reference >= fmu.count) {
        append(expected, sizeof expected, "value references from 0 to ");
        append_count(expected, sizeof expected, (double)fmu.count - 1.0);
    } else {
        append(expected, sizeof expected, "value references of ");
        append(expected, sizeof expected, type_name(type));
        append(expected, sizeof expected, " variables");
        append(received, sizeof received, ", which is ");
        append(received, sizeof received, fmu.variables[reference].name);
        append(received, sizeof received, ", ");
        append(received, sizeof received, type_name(accessed_as(fmu.variables[reference].type)));
    }
    say_error(self, function, expected, received);
}

bool readable(Instance *self, const char *function, const uint32_t references[], size_t count, const void *values,
              char type) {
    if (!references || !values) {
        char expected[160] = "";
        append_count(expected, sizeof expected, (double)count);
        append(expected, sizeof expected, references ? " values" : " value references");
        say_error(self, function, expected, "NULL");
        return false;
    }
    for (size_t i = 0; i < count; i++)
        if (!is_accessed_as(references[i], type)) {
            say_unreadable(self, function, references[i], type);
            return false;
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

bool settable(Instance *self, const char *function, const uint32_t references[], size_t count, const void *values,
              char type) {
    if (!readable(self, function, references, count, values, type)) return false;
    for (size_t i = 0; i < count; i++) {
        const Variable *variable = &fmu.variables[references[i]];
        const Role *role = role_of(variable);
        if (role->modes & self->progress.mode) continue;
        char where[400] = "";
        append(where, sizeof where, function);
        append(where, sizeof where, ": ");
        append(where, sizeof where, variable->name);
        say_error(self, where, role->expected, role->received);
        return false;
    }
    return true;
}

bool texts_good(Instance *self, const char *function, const uint32_t references[], size_t count,
                const char *const values[]) {
    for (size_t i = 0; i < count; i++) {
        bool valid = values[i] && is_utf8(values[i]);
        if (valid && strlen(values[i]) < TEXT_SIZE) continue;
        char where[400] = "";
        append(where, sizeof where, function);
        append(where, sizeof where, ": ");
        append(where, sizeof where, fmu.variables[references[i]].name);
        if (valid) say_error(self, where, "a text of fewer than 1024 bytes", "a longer one");
        else say_error(self, where, "a text in UTF-8", values[i] ? "other bytes" : "NULL");
        return false;
    }
    return true;
}

bool acceptable(const Variable *variable, double value) {
    if (!variable->expected) return true;
    bool too_small = value < variable->least || (variable->above && value <= variable->least);
    return finite_number(value) && !too_small && !(value > variable->most);
}

void say_unacceptable(Instance *self, uint32_t reference, Status status) {
    const Variable *variable = &fmu.variables[reference];
    char received[NUMBER_SIZE] = "";
    if (variable->type == 'R') number_text(self->values[reference], received);
    else append_count(received, sizeof received, self->values[reference]);
    say(self, status, variable->name, variable->expected, received, "");
}

uint32_t unusable_parameter(const Instance *self) {
    for (uint32_t i = 0; i < fmu.parameter_count; i++) {
        uint32_t reference = fmu.parameters[i];
        if (!acceptable(&fmu.variables[reference], self->values[reference])) return reference;
    }
    return fmu.count;
}

/* A parameter keeps also a value that cannot be used: a host that overlooks the status must not run with another one. */
void set_number(Instance *self, uint32_t reference, double value, bool *good) {
    const Variable *variable = &fmu.variables[reference];
    self->values[reference] = value;
    self->progress.stale = self->progress.initializing;
    if (variable->role == 'i' || acceptable(variable, value)) return;
    say_unacceptable(self, reference, ERROR);
    *good = false;
}

size_t text_place(uint32_t reference) {
    size_t place = 0;
    for (uint32_t i = 0; i < reference; i++) place += fmu.variables[i].type == 'S';
    return place;
}

void set_text(Instance *self, uint32_t reference, const char *value) {
    char *text = self->texts[text_place(reference)];
    memset(text, 0, TEXT_SIZE); /* texts are compared, and saved, as bytes */
    append(text, TEXT_SIZE, value);
    self->progress.stale = self->progress.initializing;
}
