/* Texts between UTF-8, which this library uses, and UTF-16, which Windows uses. */
#ifndef NDOB_WINDOWS_TEXT_H
#define NDOB_WINDOWS_TEXT_H

#define WIN32_LEAN_AND_MEAN /* half of the time that the compiler takes */

#include <wchar.h>
#include <windows.h>

wchar_t *wide(const char *text); /* malloc */
char *narrow(const wchar_t *text); /* malloc */
/* Return what a function of Windows writes that asks for a buffer (malloc), NULL if it fails. */
wchar_t *filled(DWORD (*function)(const wchar_t *, wchar_t *, DWORD), const wchar_t *argument);

#endif
