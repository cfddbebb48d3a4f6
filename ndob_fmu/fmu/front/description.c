/* The resource location, and what the build has written there for the front: front.txt. */
#include "front.h"

#include <ctype.h>
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

static char *joined(const char *folder, const char *name) {
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
    char *file = joined(path, "front.txt");
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

static char *whole_file(const char *path) {
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

/* Return whether the files (apart by |) can be read and pythonfmu is told to run the entry; else give the reason. What it
 * does not find there it does not survive. */
static bool complete(const char *folder, char *files, const char *entry, char *reason, size_t size) {
    for (char *name; (name = strsep(&files, "|"));) {
        char *path = joined(folder, name);
        bool there = path && can_read(path);
        free(path);
        if (there) continue;
        snprintf(reason, size, "%s: expected the file %s of the build, received none that can be read", folder, name);
        return false;
    }
    char *path = joined(folder, "slavemodule.txt");
    char *named = path ? whole_file(path) : NULL;
    free(path);
    if (named) named[strcspn(named, "\r\n")] = '\0';
    bool right = named && strcmp(named, entry) == 0;
    if (!right)
        snprintf(reason, size, "%s/slavemodule.txt: expected %s, received %.60s", folder, entry,
                 named ? named : "what cannot be read");
    free(named);
    return right;
}

bool description_read(Description *description, const char *folder, char *reason, size_t size) {
    *description = (Description){.guid = "", .executable = "", .library = "", .packages = ""};
    char *path = joined(folder, "front.txt");
    description->text = path ? whole_file(path) : NULL;
    bool good = description->text != NULL, whole = false;
    char *files = "", *entry = "";
    size_t room = 0;
    char *rest = description->text;
    for (char *line; good && (line = strsep(&rest, "\n"));) {
        char *value = strchr(line, '=');
        if (!value) continue;
        *value++ = '\0';
        if (strcmp(line, "guid") == 0) description->guid = value;
        else if (strcmp(line, "python") == 0) description->executable = value;
        else if (strcmp(line, "libpython") == 0) description->library = value;
        else if (strcmp(line, "packages") == 0) description->packages = value;
        else if (strcmp(line, "entry") == 0) entry = value;
        else if (strcmp(line, "files") == 0) files = value;
        else if (strcmp(line, "variable") == 0) good = add_variable(description, &room, value);
        else if (strcmp(line, "variables") == 0) whole = strtoul(value, NULL, 10) == description->count;
    }
    if (good && !(*description->guid && whole)) good = false;
    if (!good) {
        snprintf(reason, size, "%s: expected the file that the build wrote, received one that cannot be read",
                 path ? path : "front.txt");
    }
    good = good && complete(folder, files, entry, reason, size);
    if (!good) description_free(description);
    free(path);
    return good;
}

void description_free(Description *description) {
    free(description->text);
    free(description->variables);
    *description = (Description){0};
}
