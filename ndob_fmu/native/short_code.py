"""Texts around C functions that compilers are to make short rather than fast."""

# Translated functions call the arrays' loops: short code of their own makes the binary a quarter smaller and no slower.
# What is called once or seldom had better be short too.
SHORT_CODE = """
#if defined __clang__
#pragma clang attribute push(__attribute__((minsize)), apply_to = function)
#elif defined __GNUC__
#pragma GCC push_options
#pragma GCC optimize("Os")
#endif
"""
AS_BEFORE = """
#if defined __clang__
#pragma clang attribute pop
#elif defined __GNUC__
#pragma GCC pop_options
#endif
"""
