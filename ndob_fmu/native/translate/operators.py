"""Operators: arithmetic, comparisons, and conditions that are evaluated only where Python evaluates them."""

from __future__ import annotations

import ast

from ndob_fmu.native.translate.indices import Indices
from ndob_fmu.native.translate.kinds import (
    ARRAY,
    BOOL,
    FLOAT,
    INT,
    TEXT,
    Array,
    ComplexArray,
    Kind,
    Listing,
    Maybe,
    Table,
    c_type,
    is_nd,
    is_number,
    is_numbers,
)
from ndob_fmu.native.translate.values import Value, in_parentheses

_ARRAY_OPERATIONS = {ast.Add: "ADD", ast.Sub: "SUB", ast.Mult: "MUL", ast.Div: "DIV", ast.Pow: "POW"}


_ARRAY_OPERATIONS |= {ast.BitAnd: "AND", ast.BitOr: "OR"}


_COMPARISONS = {ast.Lt: ("<", "LT"), ast.LtE: ("<=", "LE"), ast.Gt: (">", "GT"), ast.GtE: (">=", "GE")}


_COMPARISONS |= {ast.Eq: ("==", "EQ"), ast.NotEq: ("!=", "NE")}


class Operators(Indices):
    """The part of a function's writer that writes operators."""

    def _unary(self, node: ast.UnaryOp) -> Value:
        if isinstance(node.op, ast.Not):
            return Value(f"!{self.truth(node.operand)}", BOOL)
        value = self.certain(self.expression(node.operand))
        if isinstance(value.kind, Array):
            function = "nd_not" if isinstance(node.op, ast.Invert) else "nd_negative"
            return Value(f"nd_map(arena, {function}, {value.text})", value.kind, fresh=True)
        if isinstance(node.op, ast.USub) and is_number(value.kind):
            return Value(f"(-{value.text})", INT if value.kind == BOOL else value.kind)
        raise self.no(node, "- of numbers, ~ of arrays of bool, or not")

    def _binary(self, node: ast.BinOp, want: Kind | None) -> Value:
        repeated = node.left if isinstance(node.op, ast.Mult) and isinstance(node.left, (ast.List, ast.Tuple)) else None
        if repeated and len(repeated.elts) == 1 and isinstance(repeated.elts[0], (ast.Constant, ast.Name)):
            one = self.certain(self.expression(repeated.elts[0]))
            if is_number(one.kind):
                number, times = self.as_number(one, FLOAT, node), self.number(node.right, INT)
                return Value(f"nd_filled(arena, {times}, {number})", Listing(one.kind), fresh=True)
        left = self.certain(self.expression(node.left, want if repeated else None))
        right = self.certain(self.expression(node.right))
        return self.operation(node.op, left, right, node)

    def operation(self, operator: ast.operator, left: Value, right: Value, node: ast.AST) -> Value:
        """Return what an operator of arithmetic makes of two values."""
        for one, other in ((left, right), (right, left)):
            if isinstance(one.kind, ComplexArray) and is_number(other.kind) and isinstance(operator, ast.Mult):
                return self._complex([self.operation(operator, part, other, node) for part in self.parts_of(one)])
        if isinstance(operator, ast.MatMult):
            return Value(
                f"nd_matmul(arena, {self.as_array(left, node)}, {self.as_array(right, node)})", ARRAY, fresh=True
            )
        if isinstance(left.kind, Array) or isinstance(right.kind, Array):
            name = _ARRAY_OPERATIONS.get(type(operator))
            if name is None:
                raise self.no(node, "+ - * / ** & | of arrays")
            return self.of_arrays(name, left, right, node)
        if is_number(left.kind) and is_number(right.kind):
            return self._arithmetic(operator, left, right, node)
        if isinstance(operator, ast.Mult) and isinstance(left.kind, Listing) and right.kind == INT:
            return self._repeated(left, right, left.kind)
        if isinstance(operator, ast.Add) and is_nd(left.kind) and is_nd(right.kind):
            return Value(f"nd_joined(arena, 0, {left.text}, {right.text})", left.kind, fresh=True)
        raise self.no(node, "an operation on numbers or arrays", f"{ast.unparse(node)} of {left.kind} and {right.kind}")

    def of_arrays(self, name: str, left: Value, right: Value, node: ast.AST) -> Value:
        """Return an operation entry by entry; `name` as in nd.h."""
        result = Array(BOOL) if name in ("LT", "LE", "GT", "GE", "EQ", "NE", "AND", "OR") else ARRAY
        if is_number(right.kind):
            number = self.as_number(right, FLOAT, node)
            if name == "POW" and right.text == "2":
                return Value(f"nd_map(arena, nd_square, {left.text})", result, fresh=True)
            return Value(f"nd_binary_xn(arena, ND_{name}, {self.as_array(left, node)}, {number})", result, fresh=True)
        if is_number(left.kind):
            number = self.as_number(left, FLOAT, node)
            return Value(f"nd_binary_nx(arena, ND_{name}, {number}, {self.as_array(right, node)})", result, fresh=True)
        both = f"{self.as_array(left, node)}, {self.as_array(right, node)}"
        return Value(f"nd_binary(arena, ND_{name}, {both})", result, fresh=True)

    def _arithmetic(self, operator: ast.operator, left: Value, right: Value, node: ast.AST) -> Value:
        integers = left.kind != FLOAT and right.kind != FLOAT
        if isinstance(operator, (ast.LShift, ast.BitAnd, ast.FloorDiv, ast.Mod)):
            if not integers:
                raise self.no(node, "<<, &, // and % of integers")
            if isinstance(operator, (ast.LShift, ast.BitAnd)):
                sign = "<<" if isinstance(operator, ast.LShift) else "&"
                return Value(f"({left.text} {sign} {right.text})", INT)
            function = "nd_floordiv" if isinstance(operator, ast.FloorDiv) else "nd_mod"
            return Value(f"{function}({left.text}, {right.text})", INT)
        if isinstance(operator, ast.Pow):
            x, y = self.as_number(left, FLOAT, node), self.as_number(right, FLOAT, node)
            return Value(f"pow({x}, {y})", FLOAT)
        sign = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}.get(type(operator), "")
        if not sign:
            raise self.no(node, "+ - * / ** // % << & of numbers")
        if integers and sign != "/":
            return Value(f"({self.as_number(left, INT, node)} {sign} {self.as_number(right, INT, node)})", INT)
        return Value(f"({self.as_number(left, FLOAT, node)} {sign} {self.as_number(right, FLOAT, node)})", FLOAT)

    def _repeated(self, left: Value, right: Value, kind: Listing) -> Value:
        if is_numbers(kind):
            return Value(f"nd_tile(arena, {left.text}, {right.text})", kind, fresh=True)
        left, name, i = self.held_structure(left), self.temporary(kind), self.temporary(INT)
        self.line(f"{name}.n = {left.text}.n * ({right.text});")
        self.line(f"{name}.p = nd_take_bytes(arena, sizeof({c_type(kind.element)}) * (size_t)nd_imax2({name}.n, 1));")
        self.line(f"for ({i} = 0; {i} < {name}.n; {i}++) {name}.p[{i}] = {left.text}.p[{i} % {left.text}.n];")
        return Value(name, kind, fresh=True)

    def conditions(self, node: ast.BoolOp) -> str:
        """Write conditions; those on the right are evaluated only where Python evaluates them."""
        sign = "&&" if isinstance(node.op, ast.And) else "||"
        text = self.truth(node.values[0])
        for operand in node.values[1:]:
            texts: list[str] = []

            def write(operand: ast.expr = operand, texts: list[str] = texts) -> None:
                texts.append(self.truth(operand))

            if not self.set_aside(write):
                text = f"({text} {sign} {texts[0]})"
                continue
            name = self.temporary(BOOL)
            self.line(f"{name} = {text};")
            self.line(f"if ({'' if sign == '&&' else '!'}{name}) {{")
            write()
            self.line(f"{name} = {texts[-1]};")
            self.line("}")
            text = name
        return text

    def _boolean(self, node: ast.BoolOp) -> Value:
        """Write `and` and `or` of conditions; `a or b` of other values is the first one that counts as true."""
        first = self.kind_if_known(node.values[0])
        if first not in (BOOL, Array(BOOL)):
            if isinstance(node.op, ast.Or):
                return self._or_else(node, self.expression(node.values[0]))
            raise self.no(node, "and of conditions", f"{ast.unparse(node)} of type {first}")
        return Value(self.conditions(node), BOOL)

    def _or_else(self, node: ast.BoolOp, first: Value) -> Value:
        """Write `a or b` where a is a number or a list, and the value counts."""
        if len(node.values) != 2:
            raise self.no(node, "one alternative")
        first = self.held(first)
        condition = self.as_truth(first, node)
        name = self.temporary(first.kind)
        self.line(f"if {in_parentheses(condition)} {name} = {first.text};")
        self.line("else {")
        self.line(f"{name} = {self.coerced(self.expression(node.values[1], first.kind), first.kind, node).text};")
        self.line("}")
        return Value(name, first.kind)

    def _compare(self, node: ast.Compare) -> Value:
        operands = [node.left, *node.comparators]
        if len(node.ops) == 1:
            return self._one_comparison(node, node.ops[0], self.expression(node.left), node.comparators[0])
        texts, left = [], self.expression(operands[0])
        for operator, operand in zip(node.ops, operands[1:], strict=True):
            right = self.held(self.certain(self.expression(operand)))
            texts.append(self.as_truth(self.compared(operator, left, right, node), node))
            left = right
        return Value(f"({' && '.join(texts)})", BOOL)

    def _one_comparison(self, node: ast.Compare, operator: ast.cmpop, left: Value, other: ast.expr) -> Value:
        if isinstance(operator, (ast.Is, ast.IsNot)):
            same = isinstance(operator, ast.Is)
            if isinstance(other, ast.Constant) and other.value is None:
                if not isinstance(left.kind, Maybe):
                    raise self.no(node, "a value that may be None", f"{ast.unparse(node)} of type {left.kind}")
                if is_nd(left.kind):
                    return Value(f"({'!' if same else ''}{left.text})", BOOL)
                return Value(f"{'!' if same else ''}{left.text}.some", BOOL)
            right = self.expression(other)
            if is_nd(left.kind) and is_nd(right.kind):
                return Value(f"({left.text}->p {'==' if same else '!='} {right.text}->p)", BOOL)
        if isinstance(operator, (ast.In, ast.NotIn)):
            table = self.expression(other) if isinstance(other, (ast.Name, ast.Attribute)) else left
            if isinstance(table.kind, Table):
                place = self.found(self.held_structure(table), left)
                return Value(f"({place} {'>=' if isinstance(operator, ast.In) else '<'} 0)", BOOL)
            if table.kind == Listing(TEXT):
                place = self.found(self.held_structure(table), left)
                return Value(f"({place} {'>=' if isinstance(operator, ast.In) else '<'} 0)", BOOL)
            if not isinstance(other, (ast.Tuple, ast.List)) or not is_number(left.kind):
                raise self.no(node, "`in` a mapping or names, or of a number in a tuple that is written out")
            held = self.held(left)
            equal = [self.compared(ast.Eq(), held, self.expression(one), node).text for one in other.elts]
            return Value(f"{'!' if isinstance(operator, ast.NotIn) else ''}({' || '.join(equal)})", BOOL)
        return self.compared(operator, left, self.expression(other), node)

    def compared(self, operator: ast.cmpop, left: Value, right: Value, node: ast.AST) -> Value:
        """Return the comparison of two values."""
        sign, name = _COMPARISONS.get(type(operator), ("", ""))
        left, right = self.certain(left), self.certain(right)
        if not sign:
            raise self.no(node, "a comparison of numbers or arrays")
        if isinstance(left.kind, Array) or isinstance(right.kind, Array):
            return self.of_arrays(name, left, right, node)
        if is_numbers(left.kind) and is_numbers(right.kind) and name in ("EQ", "NE"):
            return Value(f"{'!' if name == 'NE' else ''}nd_equal({left.text}, {right.text})", BOOL)
        if is_number(left.kind) and is_number(right.kind):
            kind = FLOAT if FLOAT in (left.kind, right.kind) else INT
            return Value(f"({self.as_number(left, kind, node)} {sign} {self.as_number(right, kind, node)})", BOOL)
        raise self.no(node, "a comparison of numbers or arrays", f"{left.kind} and {right.kind}")
