"""FMUs in C, which need no Python where they run: C text of a component, the shell around it, and its compilers.

The observer's C is translated from the runtime: `translate/` reads its modules and prints C, over the arrays of `c/`.
What meets there:

**Translated functions.** A function `f` of a module `m` is `m_f`, a method `M` of a class `K` is `K_M`. Its first
argument is the memory (`nd_arena`); arrays, tuples and lists of numbers are `nd`; dataclasses are structures of the
same name, with the fields that have a translation, and go by pointer. After a call `arena->error` tells what was
raised. The caller makes the memory, with `nd_start` and a `jmp_buf` in `full` for a block that is too small.

**Equations.** The runtime calls a plant through `Equations` (`runtime.equations`). In C its fields that are functions
are pairs of a pointer and an environment, `{call, env}`, which take and return `nd`. The functions that
`codegen.print_c` prints have flat arrays instead, and return a fault, 0 for none:

    int linearisation(const double *x, const double *u, const double *d, const double *p, double *result);

with the arguments of the fields of `Equations`, `Channel` and `Steps`, and the fields of a structure as arguments. A
fault of a definition is an ArithmeticError or ValueError of Python; STOPPED is None.

**The state.** `SampledObserverState` and `PaperObserverState` are structures like all others, with pointers. A step
returns a new state in the memory of the arena.
"""
