/* Numbers and characters, as the Python FMU writes them in its messages. */
#include "shell.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* printf and strtod go by the locale of the host. */
static void with_a_point(char *text) {
    for (; *text; text++)
        if (!strchr("0123456789+-einfa", *text)) *text = '.';
}

void short_number_text(double number, char text[NUMBER_SIZE]) {
    snprintf(text, NUMBER_SIZE, "%g", number);
    with_a_point(text);
}

void number_text(double number, char text[NUMBER_SIZE]) {
    if (!finite_number(number)) {
        strcpy(text, not_a_number(number) ? "nan" : number > 0.0 ? "inf" : "-inf");
        return;
    }
    int digits = 1;
    do {
        snprintf(text, NUMBER_SIZE, "%.*e", digits - 1, number);
    } while (strtod(text, NULL) != number && ++digits <= 17);
    int exponent = atoi(strchr(text, 'e') + 1);
    if (exponent >= -4 && exponent < 16) {
        int decimals = digits - 1 - exponent;
        snprintf(text, NUMBER_SIZE, "%.*f", decimals < 1 ? 1 : decimals, number);
    }
    with_a_point(text);
}

void append(char *line, size_t size, const char *text) {
    size_t used = strlen(line), length = strlen(text);
    if (length > size - used - 1) length = size - used - 1;
    memcpy(line + used, text, length);
    line[used + length] = '\0';
}
