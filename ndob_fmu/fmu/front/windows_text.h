/* Texts between UTF-8, which the front uses, and UTF-16, which Windows uses. */
#ifndef NDOB_FRONT_WINDOWS_TEXT_H
#define NDOB_FRONT_WINDOWS_TEXT_H

#include <wchar.h>

wchar_t *wide(const char *text); /* malloc */
char *narrow(const wchar_t *text); /* malloc */

#endif
