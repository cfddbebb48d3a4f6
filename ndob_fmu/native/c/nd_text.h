/* Text of numbers and messages. */
#ifndef ND_TEXT_H
#define ND_TEXT_H

#include <stdarg.h>
#include <stddef.h>

/* As printf, with %s, %d, %e, %f and %g, their precision, and +. */
void nd_print(char *to, size_t size, const char *format, ...);
void nd_print_of(char *to, size_t size, const char *format, va_list arguments);
void nd_shortest(char *to, size_t size, double number); /* the fewest digits that give the number back, as repr */

#endif
