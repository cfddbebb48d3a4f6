/* Messages to the host, by FMI's categories. */
#include "shell.h"

#include <string.h>

static const char *const CATEGORIES[] = {"logAll", "logStatusWarning", "logStatusDiscard", "logStatusError",
                                         "logStatusFatal"};
static const char CUT[] = "\xe2\x80\xa6"; /* … */

#define LONGEST 300 /* characters of a message */

/* Make the text one line of at most LONGEST characters, without its middle where it is longer. */
static void make_line(const char *text, char line[MESSAGE_SIZE]) {
    size_t count = 0, place = 0, used = 0, half = (LONGEST - 1) / 2;
    for (const char *c = text; *c; c += character(c) ? character(c) : 1) count++;
    line[0] = '\0';
    while (*text) {
        size_t length = character(text);
        bool left_out = count > LONGEST && place >= half && place < count - half;
        if (left_out && place == half) append(line, MESSAGE_SIZE, CUT), used = strlen(line);
        for (size_t i = 0; !left_out && i < (length ? length : 1); i++) {
            unsigned char byte = (unsigned char)text[i];
            line[used++] = !length ? '?' : byte < ' ' || byte == 127 ? ' ' : text[i];
        }
        line[used] = '\0';
        text += length ? length : 1;
        place++;
    }
}

void log_message(Log *log, Status status, const char *message) {
    if (status > log->worst) log->worst = status;
    bool wanted = status >= DISCARD || (log->on && (log->categories & (1u << status)));
    if (!log->logger || !wanted) return;
    char line[MESSAGE_SIZE];
    make_line(message, line);
    log->send(log->logger, log->environment, log->name, status, CATEGORIES[status], line);
}

/* Return the categories' bits, and in `unknown` the first name that is not a category. */
static unsigned bits_of(size_t count, const char *const names[], const char **unknown) {
    unsigned bits = 0;
    for (size_t i = 0; i < count; i++) {
        bool known = false;
        for (unsigned status = OK; status <= FATAL && names[i]; status++)
            if (strcmp(names[i], CATEGORIES[status]) == 0) {
                bits |= status == OK ? ALL_CATEGORIES : 1u << status;
                known = true;
            }
        if (!known && !*unknown) *unknown = names[i] ? names[i] : "NULL";
    }
    return bits;
}

void tell(Instance *self, Status status, const char *message) { log_message(&self->log, status, message); }

void say(Instance *self, Status status, const char *where, const char *expected, const char *received,
         const char *likely) {
    const char *parts[] = {where, ": expected ", expected, ", received ", received, "; likely cause: ", likely};
    char line[2 * MESSAGE_SIZE] = "";
    for (size_t i = 0; i < (*likely ? 7u : 5u); i++) append(line, sizeof line, parts[i]);
    tell(self, status, line);
}

bool set_logging(Instance *self, const char *function, bool on, size_t count, const char *const names[]) {
    if (count && !names) {
        say_error(self, function, "log categories", "NULL");
        return false;
    }
    const char *unknown = NULL;
    self->log.categories = count ? bits_of(count, names, &unknown) : ALL_CATEGORIES;
    self->log.on = on;
    if (unknown) say(self, WARNING, function, "log categories of the model description", unknown, "");
    return true;
}
