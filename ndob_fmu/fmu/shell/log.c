/* Messages to the host, by FMI's categories, and the status that the core's messages carry: the worst one during a call
 * becomes the call's. */
#include "shell.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char *const CATEGORIES[] = {
    [fmi2OK] = "logAll",
    [fmi2Warning] = "logStatusWarning",
    [fmi2Discard] = "logStatusDiscard",
    [fmi2Error] = "logStatusError",
    [fmi2Fatal] = "logStatusFatal",
};

/* Make the text one line of UTF-8, in place. */
static void one_line(char *text) {
    char *to = text;
    for (const char *from = text; *from;) {
        size_t length = character(from);
        char c = (unsigned char)*from < ' ' || *from == 127 ? ' ' : length ? *from : '?';
        if (c != ' ' || (to > text && to[-1] != ' ')) *to++ = c;
        for (size_t i = 1; i < length; i++) *to++ = from[i];
        from += length ? length : 1;
    }
    while (to > text && to[-1] == ' ') to--;
    *to = '\0';
}

/* Return a format that prints the text, which may be such a format already (malloc). A host takes the text as a printf
 * format, or does not: with doubled percent signs it reads well either way. */
static char *printf_format(const char *text) {
    char *format = malloc(2 * strlen(text) + 1);
    char *to = format;
    for (const char *from = text; format && *from; from++) {
        *to++ = *from;
        if (*from != '%') continue;
        *to++ = '%';
        if (from[1] == '%') from++;
    }
    if (format) *to = '\0';
    return format;
}

static void send(Log *log, fmi2Status status, const char *category, const char *text) {
    if (!log->logger) return;
    bool wanted = status >= fmi2Discard || (log->on && (log->categories & (1u << status)));
    if (!wanted) return;
    char *format = printf_format(text);
    if (!format) return;
    one_line(format);
    log->logger(log->environment, log->name, status, category, format);
    free(format);
}

void log_line(Log *log, fmi2Status status, const char *format, ...) {
    char text[2048];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    send(log, status, CATEGORIES[status], text);
}

void log_from_core(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                    fmi2String message, ...) {
    (void)name, (void)category;
    Log *log = environment;
    if (status > fmi2Fatal) status = fmi2Error;
    if (status > log->worst) log->worst = status;
    if (log->overheard) {
        snprintf(log->overheard, OVERHEARD_SIZE, "%s", message ? message : "");
        one_line(log->overheard);
        return;
    }
    send(log, status, CATEGORIES[status], message ? message : "");
}

unsigned log_categories(size_t count, const fmi2String names[], const char **unknown) {
    unsigned bits = 0;
    *unknown = NULL;
    for (size_t i = 0; i < count; i++) {
        bool known = false;
        for (unsigned status = fmi2OK; status <= fmi2Fatal && names[i]; status++)
            if (strcmp(names[i], CATEGORIES[status]) == 0) {
                bits |= status == fmi2OK ? ALL_CATEGORIES : 1u << status;
                known = true;
            }
        if (!known && !*unknown) *unknown = names[i] ? names[i] : "NULL";
    }
    return bits;
}
