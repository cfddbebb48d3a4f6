/* The resource location, and front.txt in it, which the build writes for this library. */
#include "shell.h"

#include <ctype.h>
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

char *path_in(const char *folder, const char *name) {
    char *path = malloc(strlen(folder) + strlen(name) + 2);
    if (path) sprintf(path, "%s/%s", folder, name);
    return path;
}

/* Return the path that a file URI means: file:/x, file:///x, file://localhost/x, or a bare path. */
static const char *without_scheme(const char *location) {
    if (strncasecmp(location, "file:", 5) != 0) return location;
    const char *path = location + 5;
    if (strncmp(path, "//", 2) != 0) return path_of_uri(path);
    path += 2;
    return path_of_uri(strncasecmp(path, "localhost/", 10) == 0 ? path + 9 : path);
}

static int digit(char c) { return isdigit((unsigned char)c) ? c - '0' : tolower((unsigned char)c) - 'a' + 10; }

static void decode_percent(char *text) {
    char *to = text;
    for (const char *from = text; *from; from++, to++) {
        *to = *from;
        if (*from == '%' && isxdigit((unsigned char)from[1]) && isxdigit((unsigned char)from[2])) {
            int byte = digit(from[1]) * 16 + digit(from[2]);
            if (!byte) continue; /* it would end the path */
            *to = (char)byte;
            from += 2;
        }
    }
    *to = '\0';
}

static char *folder_with_description(const char *path) {
    char *file = path_in(path, "front.txt");
    char *folder = file && can_read(file) ? real_folder(path) : NULL;
    free(file);
    return folder;
}

char *resources_folder(const char *location, char *reason, size_t size) {
    if (!location || !*location) {
        snprintf(reason, size, "fmuResourceLocation: expected the URI of the FMU's resources folder, received %s",
                 location ? "an empty string" : "NULL");
        return NULL;
    }
    const char *raw = without_scheme(location);
    char *decoded = strdup(raw);
    if (!decoded) return NULL;
    decode_percent(decoded);
    char *folder = folder_with_description(decoded);
    /* A host that does not encode a folder named "100%25" means it as it stands. */
    if (!folder) folder = folder_with_description(raw);
    if (!folder)
        snprintf(
            reason, size,
            "fmuResourceLocation: expected the URI of the FMU's resources folder, received \"%s\", where front.txt "
            "cannot be read",
            location);
    free(decoded);
    return folder;
}

char *file_text(const char *path) {
    FILE *file = file_open(path);
    if (!file) return NULL;
    size_t used = 0, room = 1 << 14;
    char *text = malloc(room);
    while (text) {
        used += fread(text + used, 1, room - used - 1, file);
        if (used < room - 1) break;
        char *larger = realloc(text, room *= 2);
        if (!larger) free(text);
        text = larger;
    }
    fclose(file);
    if (text) text[used] = '\0';
    return text;
}

static bool add_variable(Description *description, size_t *room, const char *value) {
    if (strlen(value) < 3 || value[2] != ' ') return false;
    if (description->count == *room) {
        Variable *larger = realloc(description->variables, (*room = 2 * *room + 64) * sizeof *larger);
        if (!larger) return false;
        description->variables = larger;
    }
    description->variables[description->count++] = (Variable){value[0], value[1], value + 3};
    return true;
}

/* Return whether the files (apart by |) can be read; else give the reason. */
static bool complete(const char *folder, const char *files, char *reason, size_t size) {
    char *names = strdup(files), *rest = names;
    for (char *name; names && (name = strsep(&rest, "|"));) {
        char *path = path_in(folder, name);
        bool there = path && can_read(path);
        free(path);
        if (there) continue;
        snprintf(reason, size, "%s: expected the file %s of the build, received none that can be read", folder, name);
        free(names);
        return false;
    }
    free(names);
    return names != NULL;
}

const char *description_value(const Description *description, const char *key) {
    for (size_t i = 0; i < description->setting_count; i++)
        if (strcmp(description->settings[i].key, key) == 0) return description->settings[i].value;
    return "";
}

bool description_read(Description *description, const char *folder, char *reason, size_t size) {
    *description = (Description){.guid = ""};
    char *path = path_in(folder, "front.txt");
    description->text = path ? file_text(path) : NULL;
    bool good = description->text != NULL, whole = false;
    size_t room = 0;
    char *rest = description->text;
    for (char *line; good && (line = strsep(&rest, "\n"));) {
        char *value = strchr(line, '=');
        if (!value) continue;
        *value++ = '\0';
        if (strcmp(line, "variable") == 0) good = add_variable(description, &room, value);
        else if (strcmp(line, "variables") == 0) whole = strtoul(value, NULL, 10) == description->count;
        else if (description->setting_count == MOST_SETTINGS) good = false;
        else description->settings[description->setting_count++] = (Setting){line, value};
    }
    description->guid = description_value(description, "guid");
    if (good && !(*description->guid && whole)) good = false;
    if (!good) {
        snprintf(reason, size, "%s: expected the file that the build wrote, received one that cannot be read",
                 path ? path : "front.txt");
    }
    good = good && complete(folder, description_value(description, "files"), reason, size);
    if (!good) description_free(description);
    free(path);
    return good;
}

void description_free(Description *description) {
    free(description->text);
    free(description->variables);
    *description = (Description){0};
}
