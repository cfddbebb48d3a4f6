"""SymPy's expressions as C text, which evaluates to the bits of the Python text.

Where Python raises an exception, the C text sets `fault` to one of those in RUNTIME, and the value is undefined.
"""

from __future__ import annotations

import sympy
from sympy.printing.precedence import PRECEDENCE, precedence
from sympy.printing.pycode import PythonCodePrinter

from ndob_fmu.errors import ModelError

# What the text of expressions uses, besides math.h: Python's rules of when a number has no value.
RUNTIME = """\
/* Why a generated function has no result; 0 where it has one. */
enum { STOPPED = 1, DIVISION_BY_ZERO, OUTSIDE_DOMAIN, OUTSIDE_RANGE, POWER_OUTSIDE_RANGE };

static inline double divided(double a, double b, int *fault) {
    if (b == 0.0 && !*fault) *fault = DIVISION_BY_ZERO;
    return a / b;
}

/* A function of one argument, of which the value is known; `infinite` is the fault where it has none that is finite. */
static inline double of_one(double value, double argument, int infinite, int *fault) {
    if (finite_number(value) || *fault) return value;
    if (not_a_number(value)) *fault = not_a_number(argument) ? 0 : OUTSIDE_DOMAIN;
    else if (finite_number(argument)) *fault = infinite;
    return value;
}

/* Python rounds to an integer of any length, which is finite. */
static inline double rounded(double value, int *fault) {
    if (!finite_number(value) && !*fault) *fault = not_a_number(value) ? OUTSIDE_DOMAIN : OUTSIDE_RANGE;
    return value;
}

/* Compilers write pow(x, 2.0) as x * x, which is another number now and then: they must not know that it is pow. */
static double (*const volatile c_pow)(double, double) = pow;

static inline double raised(double base, double exponent, int *fault) {
    double value = c_pow(base, exponent);
    if (finite_number(value) || *fault) return value;
    if (base == 0.0 && exponent < 0.0) *fault = DIVISION_BY_ZERO;
    else if (not_a_number(value) && !not_a_number(base) && !not_a_number(exponent)) *fault = OUTSIDE_DOMAIN;
    else if (!not_a_number(value) && finite_number(base) && finite_number(exponent)) *fault = POWER_OUTSIDE_RANGE;
    return value;
}

static inline double remainder_of(double a, double b, int *fault) {
    if (b == 0.0 && !*fault) *fault = DIVISION_BY_ZERO;
    double rest = fmod(a, b);
    if (rest == 0.0) return copysign(0.0, b);
    return (rest < 0.0) != (b < 0.0) ? rest + b : rest;
}

static inline double least_of(double a, double b) { return b < a ? b : a; }
static inline double most_of(double a, double b) { return b > a ? b : a; }
static inline double sign_of(double a) { return a == 0.0 ? 0.0 : copysign(1.0, a); }
"""

# C's names of the functions of one argument, by SymPy's.
_OF_ONE = {
    **{name: name for name in ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh")},
    **{
        name: name
        for name in ("atanh", "exp", "expm1", "log", "log1p", "log2", "log10", "sqrt", "erf", "erfc", "floor")
    },
    **{"ceiling": "ceil", "gamma": "tgamma", "loggamma": "lgamma"},
}
_OVERFLOWING = ("exp", "expm1", "sinh", "cosh", "tgamma", "lgamma")  # the others have a pole where they are infinite


def _wrapper(name: str) -> str:
    infinite = "OUTSIDE_RANGE" if name in _OVERFLOWING else "OUTSIDE_DOMAIN"
    value = "rounded(" if name in ("floor", "ceil") else "of_one("
    rest = ", fault)" if name in ("floor", "ceil") else f", x, {infinite}, fault)"
    return f"static inline double {name}_of(double x, int *fault) {{ return {value}{name}(x){rest}; }}\n"


RUNTIME += "".join(map(_wrapper, sorted(set(_OF_ONE.values()))))


class _Printer(PythonCodePrinter):  # type: ignore[misc]
    """The printer of the Python text, with C's words for the same operations in the same order."""

    def _print_Symbol(self, symbol: sympy.Symbol) -> str:
        return str(symbol.name if symbol.name.startswith("_") else f"{symbol.name}_")

    def _print_Float(self, number: sympy.Float) -> str:
        return repr(float(number))

    def _print_Integer(self, number: sympy.Integer) -> str:
        return f"{int(number)}.0"

    def _print_Rational(self, number: sympy.Rational) -> str:
        return f"{number.p}.0/{number.q}.0"

    def _print_Half(self, number: sympy.Rational) -> str:
        return self._print_Rational(number)

    def _print_NumberSymbol(self, number: sympy.NumberSymbol) -> str:
        return repr(float(number))

    _print_Pi = _print_Exp1 = _print_NumberSymbol

    def _print_NaN(self, _: sympy.Expr) -> str:
        return "NAN"

    def _print_Infinity(self, _: sympy.Expr) -> str:
        return "HUGE_VAL"

    def _print_NegativeInfinity(self, _: sympy.Expr) -> str:
        return "(-HUGE_VAL)"

    def _print_BooleanTrue(self, _: sympy.Basic) -> str:
        return "1.0"

    def _print_BooleanFalse(self, _: sympy.Basic) -> str:
        return "0.0"

    def _print_Mul(self, product: sympy.Mul) -> str:
        """As SymPy's own, with the division by name."""
        level = precedence(product)
        coefficient, rest = product.as_coeff_Mul()
        sign = ""
        if coefficient < 0:
            product, sign = sympy.core.mul._keep_coeff(-coefficient, rest), "-"
        above, below = [], []
        for factor in (
            product.as_ordered_factors() if self.order not in ("old", "none") else sympy.Mul.make_args(product)
        ):
            if factor.is_commutative and factor.is_Pow and factor.exp.is_Rational and factor.exp.is_negative:
                below.append(
                    sympy.Pow(factor.base, -factor.exp, evaluate=False)
                    if factor.exp != -1
                    else sympy.Pow(factor.base, -factor.exp)
                )
            else:
                above.append(factor)
        above = above or [sympy.S.One]
        strong = 0.5 * (PRECEDENCE["Pow"] + PRECEDENCE["Mul"])
        upper = "*".join(self.parenthesize(factor, strong if len(above) == 1 and sign else level) for factor in above)
        lower = "*".join(self.parenthesize(factor, level) for factor in below)
        return f"divided({sign}{upper}, {lower}, &_fault)" if below else sign + upper

    def _print_Pow(self, power: sympy.Pow, rational: bool = False) -> str:
        base, exponent = self._print(power.base), power.exp
        if exponent == -1:
            return f"divided(1.0, {base}, &_fault)"
        if abs(exponent) == sympy.Rational(1, 2):
            root = self._of_one("sqrt", power.base)
            return root if exponent > 0 else f"divided(1.0, {root}, &_fault)"
        return f"raised({base}, {self._print(exponent)}, &_fault)"

    def _of_one(self, function: str, argument: sympy.Expr) -> str:
        return f"{function}_of({self._print(argument)}, &_fault)"

    def _print_Function(self, expression: sympy.Function) -> str:
        name = expression.func.__name__
        if name in _OF_ONE and len(expression.args) == 1:
            return self._of_one(_OF_ONE[name], expression.args[0])
        raise NotImplementedError(name)

    def _print_ExpBase(self, expression: sympy.exp) -> str:
        return self._of_one("exp", expression.exp)

    _print_exp = _print_ExpBase

    def _print_atan2(self, expression: sympy.atan2) -> str:
        return f"atan2({', '.join(map(self._print, expression.args))})"

    def _print_Abs(self, expression: sympy.Abs) -> str:
        return f"fabs({self._print(expression.args[0])})"

    def _print_sign(self, expression: sympy.sign) -> str:
        return f"sign_of({self._print(expression.args[0])})"

    def _print_Mod(self, expression: sympy.Mod) -> str:
        return f"remainder_of({', '.join(map(self._print, expression.args))}, &_fault)"

    def _print_Min(self, expression: sympy.Min) -> str:
        return self._folded("least_of", expression)

    def _print_Max(self, expression: sympy.Max) -> str:
        return self._folded("most_of", expression)

    def _folded(self, function: str, expression: sympy.Expr) -> str:
        text, *rest = map(str, map(self._print, expression.args))
        for each in rest:
            text = f"{function}({text}, {each})"
        return text

    def _print_Relational(self, relation: sympy.Rel) -> str:
        return f"({self._print(relation.lhs)} {relation.rel_op} {self._print(relation.rhs)})"

    def _print_And(self, expression: sympy.And) -> str:
        return "(" + " && ".join(map(self._condition, self._sorted(expression))) + ")"

    def _print_Or(self, expression: sympy.Or) -> str:
        return "(" + " || ".join(map(self._condition, self._sorted(expression))) + ")"

    def _print_Not(self, expression: sympy.Not) -> str:
        return f"!{self._condition(expression.args[0])}"

    def _sorted(self, expression: sympy.Basic) -> list[sympy.Basic]:
        return sorted(expression.args, key=sympy.default_sort_key)

    def _condition(self, expression: sympy.Basic) -> str:
        return {sympy.true: "1", sympy.false: "0"}.get(expression) or str(self._print(expression))

    def _print_Piecewise(self, pieces: sympy.Piecewise) -> str:
        text, last = "NAN", len(pieces.args) - 1
        for place, (value, condition) in reversed(list(enumerate(pieces.args))):
            is_rest = place == last and condition == sympy.true
            text = self._print(value) if is_rest else f"({self._condition(condition)} ? {self._print(value)} : {text})"
        return f"({text})"

    def _print_ITE(self, expression: sympy.Basic) -> str:
        condition, value, other = expression.args
        return f"({self._condition(condition)} ? {self._condition(value)} : {self._condition(other)})"


for _name in _OF_ONE.keys() - {"exp"}:  # SymPy's printer for Python has a method of its own for each
    setattr(_Printer, f"_print_{_name}", _Printer._print_Function)

_PRINTER = _Printer({"fully_qualified_modules": True})


def c_expression(expression: sympy.Basic) -> str:
    """Return the expression in C. Raises ModelError for a function that has no C form."""
    try:
        return str(_PRINTER.doprint(expression))
    except NotImplementedError as error:
        raise ModelError.report(
            "f",
            expected="functions that can be written in C",
            received=str(expression),
            likely="a function of SymPy that C's library does not have; build with --target python",
        ) from error
