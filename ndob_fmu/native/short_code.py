"""Texts around C functions that compilers are to make fast, or short: binaries are built to be short (compile.py)."""

from __future__ import annotations

_FAST_CODE = """
#if defined __GNUC__ && !defined __clang__
#pragma GCC push_options
#pragma GCC optimize("O2")
#endif
"""
_AFTER_FAST = """
#if defined __GNUC__ && !defined __clang__
#pragma GCC pop_options
#endif
"""
# clang knows of no faster code than the command asks for, but of shorter. What is not scheduled is packed better.
_SHORT_CODE = """
#if defined __clang__
#pragma clang attribute push(__attribute__((minsize)), apply_to = function)
#elif defined __GNUC__
#pragma GCC push_options
#pragma GCC optimize("Os", "no-schedule-insns2", "no-inline-functions-called-once", "no-math-errno", \
                     "no-caller-saves", "no-ivopts", "no-move-loop-invariants")
#endif
"""
_AFTER_SHORT = """
#if defined __clang__
#pragma clang attribute pop
#elif defined __GNUC__
#pragma GCC pop_options
#endif
"""


def fast(*texts: str) -> list[str]:
    """Return C texts with functions that every step calls."""
    return [_FAST_CODE, *texts, _AFTER_FAST]


def short(*texts: str) -> list[str]:
    """Return C texts with functions that steps seldom call, or that call those."""
    return [_SHORT_CODE, *texts, _AFTER_SHORT]
