"""What there is of NumPy and of Python's own functions, by the functions of nd.h that do the same."""

from __future__ import annotations

from dataclasses import dataclass

from ndob_fmu.native.translate.kinds import ARRAY, BOOL, FLOAT, INT, NUMBERS, Array, Kind, Pack

# Functions of one number, which NumPy applies to each entry too. The second name: the function for entries.
OF_NUMBERS: dict[str, tuple[str, str, Kind]] = {
    "abs": ("fabs", "fabs", FLOAT),
    "isfinite": ("nd_isfinite", "nd_isfinite", BOOL),
    "isnan": ("nd_isnan", "nd_isnan", BOOL),
    "isinf": ("nd_isinf", "nd_isinf", BOOL),
    "round": ("nearbyint", "nearbyint", FLOAT),
}
for _name in ("sqrt", "exp", "log", "log2", "log10", "log1p", "exp2", "sin", "cos", "ceil", "floor"):
    OF_NUMBERS[_name] = (_name, _name, FLOAT)
# Functions of two, entry by entry. `hypot` is none of them: the C libraries of two processors round it differently.
OF_TWO = {"maximum": "MAX", "minimum": "MIN", "copysign": "COPYSIGN"}
OF_TWO |= {"subtract": "SUB", "add": "ADD", "multiply": "MUL"}


@dataclass(frozen=True)
class Known:
    """A function of arrays: its name in C, the kinds of its arguments, of its result, and whether it can fail."""

    c: str
    arguments: tuple[Kind, ...]
    result: Kind
    fails: bool = False
    memory: bool = True  # whether it takes the memory as its first argument


_ONE, _TWO = (ARRAY,), (ARRAY, ARRAY)
FUNCTIONS: dict[str, Known] = {
    "np.linalg.solve": Known("nd_solve", _TWO, ARRAY, fails=True),
    "np.linalg.inv": Known("nd_inv", _ONE, ARRAY, fails=True),
    "np.linalg.pinv": Known("nd_pinv", _ONE, ARRAY, fails=True),
    "np.linalg.cond": Known("nd_cond", _ONE, FLOAT, fails=True),
    "np.linalg.eigh": Known("nd_eigh", _ONE, Pack((ARRAY, ARRAY)), fails=True),
    "np.polynomial.legendre.leggauss": Known("nd_leggauss", (INT,), Pack((ARRAY, ARRAY))),
    "np.diag": Known("nd_diag", _ONE, ARRAY),
    "np.linspace": Known("nd_linspace", (FLOAT, FLOAT, INT), ARRAY),
    "np.geomspace": Known("nd_geomspace", (FLOAT, FLOAT, INT), ARRAY),
    "np.flatnonzero": Known("nd_indices", _ONE, Array(INT)),
    "np.argwhere": Known("nd_argwhere", _ONE, Array(INT)),
    "np.argmin": Known("nd_argmin", _ONE, INT, memory=False),
    "np.argmax": Known("nd_argmax", _ONE, INT, memory=False),
    "np.mean": Known("nd_mean", _ONE, FLOAT, memory=False),
    "np.cumsum": Known("nd_cumsum", _ONE, ARRAY),
    "np.diff": Known("nd_diff", _ONE, ARRAY),
    "np.delete": Known("nd_delete", (ARRAY, INT), ARRAY),
    "np.nextafter": Known("nextafter", (FLOAT, FLOAT), FLOAT, memory=False),
    "math.ulp": Known("nd_ulp", (FLOAT,), FLOAT, memory=False),
    "bisect_right": Known("nd_searchsorted_right", (NUMBERS, FLOAT), INT, memory=False),
    "math.nextafter": Known("nextafter", (FLOAT, FLOAT), FLOAT, memory=False),
    "np.tri": Known("nd_tri", (INT,), Array(BOOL)),
    "sorted": Known("nd_sorted", _ONE, NUMBERS),
    "math.remainder": Known("remainder", (FLOAT, FLOAT), FLOAT, memory=False),
    "np.dot": Known("nd_matmul", _TWO, ARRAY),
    "math.factorial": Known("nd_factorial", (INT,), FLOAT, memory=False),
    "math.pow": Known("pow", (FLOAT, FLOAT), FLOAT, memory=False),
}
# Functions of the runtime that are written by hand in native/c, beside their twins in Python.
BY_HAND: dict[tuple[str, str], Known] = {
    ("ndob_fmu.runtime.numerics.kalman", "triangular"): Known("nd_triangular", _ONE, ARRAY),
    ("ndob_fmu.runtime.numerics.kalman", "_lower"): Known("nd_tri", (INT,), Array(BOOL)),
    ("ndob_fmu.runtime.step.jump_bank", "with_innovation"): Known(
        "nd_with_innovation", (ARRAY, ARRAY, ARRAY, FLOAT, FLOAT), Pack((ARRAY, ARRAY, ARRAY))
    ),
    ("ndob_fmu.runtime.blocks.random_numbers", "uniforms"): Known("nd_uniforms", (INT, FLOAT), NUMBERS),
}
# What is reduced, by functions and methods of arrays.
REDUCTIONS: dict[str, tuple[str, Kind]] = {
    "sum": ("SUM", FLOAT),
    "any": ("ANY", BOOL),
    "all": ("ALL_TRUE", BOOL),
    "max": ("LARGEST", FLOAT),
    "min": ("SMALLEST", FLOAT),
}
STACKS = {"vstack": "nd_vstack", "column_stack": "nd_column_stack", "stack": "nd_stack"}
# Errors by the classes that a handler catches: ValueError is the base of LinAlgError.
ERRORS = {
    "np.linalg.LinAlgError": ("ND_LINALG",),
    "ArithmeticError": ("ND_ARITHMETIC",),
    "ValueError": ("ND_ARITHMETIC", "ND_LINALG"),
    "DesignError": ("ND_DESIGN",),
    "AssumptionError": ("ND_ASSUMPTION",),
    "IntegrationError": ("ND_INTEGRATION",),
}
