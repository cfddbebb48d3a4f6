/* Numbers and characters, as the Python FMU writes them in its messages. */
#include "shell.h"

#include <string.h>

void short_number_text(double number, char text[NUMBER_SIZE]) { nd_print(text, NUMBER_SIZE, "%g", number); }

void number_text(double number, char text[NUMBER_SIZE]) { nd_shortest(text, NUMBER_SIZE, number); }

void append(char *line, size_t size, const char *text) {
    size_t used = strlen(line), length = strlen(text);
    if (length > size - used - 1) length = size - used - 1;
    memcpy(line + used, text, length);
    line[used + length] = '\0';
}
