"""A translator from the runtime's typed Python and NumPy to C99.

It reads the source of named modules and takes the types from their annotations, which mypy checks: a name that mypy
knows not to be None is not None here either. What it does not understand it refuses, with file and line.

`kinds` has the types, `program` what the modules hold, `library` what there is of NumPy. A function is written by one
class in parts, each of which knows those before it: `conversions`, `constants`, `indices`, `operators`, `expressions`,
`numpy_calls`, `python_calls`, `calls`, `loops`, `assignments`, `statements`, `functions`. `print_c` puts all together;
`storage` adds how values move, and how a state becomes numbers.
"""
