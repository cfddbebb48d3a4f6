"""A translator from the runtime's typed Python and NumPy to C99.

It reads the source of named modules and takes the types from their annotations, which mypy checks: a name that mypy
knows not to be None is not None here either. What it does not understand it refuses, with file and line.

One module after the other: `kinds` (types), `program` (what the modules hold), `expressions`, `calls`, `library`
(what there is of Python and NumPy), `statements`, `print_c`.
"""
