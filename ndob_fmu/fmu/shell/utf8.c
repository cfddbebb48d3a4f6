/* UTF-8 as Python's strict decoder takes it (RFC 3629): no overlong forms, no surrogates, nothing above U+10FFFF. */
#include "shell.h"

size_t character(const char *text) {
    const unsigned char *c = (const unsigned char *)text;
    unsigned char first = c[0], least = 0x80, most = 0xbf; /* of the second byte */
    size_t length = first < 0x80                   ? 1
                    : first >= 0xc2 && first < 0xe0 ? 2
                    : first >= 0xe0 && first < 0xf0 ? 3
                    : first >= 0xf0 && first < 0xf5 ? 4
                                                    : 0;
    if (first == 0xe0) least = 0xa0;      /* below it: overlong */
    else if (first == 0xed) most = 0x9f;  /* above it: surrogates */
    else if (first == 0xf0) least = 0x90; /* below it: overlong */
    else if (first == 0xf4) most = 0x8f;  /* above it: beyond U+10FFFF */
    if (length > 1 && (c[1] < least || c[1] > most)) return 0;
    for (size_t i = 2; i < length; i++)
        if ((c[i] & 0xc0) != 0x80) return 0;
    return length;
}

bool is_utf8(const char *text) {
    for (size_t length; *text; text += length)
        if (!(length = character(text))) return false;
    return true;
}
