"""GLSL source of a `Polynomial`, its coefficients written as literals.

Compilers turn literals into the operands of multiply-adds; coefficients in a buffer cost a read each, which makes
software renderers ten times slower. The Chebyshev series is multiplied out to monomials of the same scaled variables
and nested (Horner). At the degrees of the models, with inputs scaled to -1..1, that loses a few of float32's rounding
units: tests/rendering/test_shader_polynomial.py has the measured errors.
"""

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly

from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import BOX_SLACK, Polynomial, exponents

_COMPONENTS = "xyzw"
_HELD = 2


def value_source(name: str, polynomial: Polynomial) -> str:
    """GLSL of `vecK NAME(vecN inputs)` and of `bool NAME_contains(vecN inputs)`, the polynomial's `box.contains`.

    Args:
        name: of the function.
        polynomial: of N = 2 to 4 variables, with K = 1 to 4 outputs.
    """
    variables, outputs = len(polynomial.box.low), polynomial.coefficients.shape[1]
    table = _monomials(polynomial)
    return f"""
{_vector(outputs)} {name}(vec{variables} inputs)
{{
    vec{variables} s = {_scaled(polynomial, slice(None))};
    return {_nested(table, [f"s.{c}" for c in _COMPONENTS[:variables]], polynomial.degree)};
}}
{_contains_source(name, polynomial)}"""


def held_source(name: str, polynomial: Polynomial) -> str:
    """GLSL for a solve in the last two of four variables, in which the first two stay as they are.

    `void NAME_hold(vec2 inputs)` multiplies the first two out once per pixel; `vecK NAME(vec2 inputs, out matKx2)` is
    then a polynomial of the last two only (21 terms instead of 126 at degree 5), with its Jacobian: column j is the
    derivative by input j, in the inputs' units. `bool NAME_contains(vec4 inputs)` is as in `value_source`.

    Args:
        name: of the functions.
        polynomial: of four variables, with K = 2 to 4 outputs.
    """
    outputs, table, degree = polynomial.coefficients.shape[1], _monomials(polynomial), polynomial.degree
    vector, powers = _vector(outputs), [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    held = "\n".join(
        f"    {name}_{i}_{j} = {_nested(table[:, :, i, j], ['s.x', 's.y'], degree - i - j)};" for i, j in powers
    )
    per_unit = _literal(_per_unit(polynomial)[_HELD:])
    return f"""
{vector} {", ".join(f"{name}_{i}_{j}" for i, j in powers)};

void {name}_hold(vec2 inputs)
{{
    vec2 s = {_scaled(polynomial, slice(0, _HELD))};
{held}
}}

{vector} {name}(vec2 inputs, out mat2x{outputs} jacobian)
{{
    vec2 s = {_scaled(polynomial, slice(_HELD, None))};
    {vector} row, slope, value = {vector}(0.0), by_x = {vector}(0.0), by_y = {vector}(0.0);
{_horner_with_slopes(name, vector, degree)}
    jacobian = mat2x{outputs}(by_x * {per_unit}.x, by_y * {per_unit}.y);
    return value;
}}
{_contains_source(name, polynomial)}"""


def _horner_with_slopes(name: str, vector: str, degree: int) -> str:
    """Statements that leave value, by_x and by_y of the sum over i, j of NAME_i_j s.x^i s.y^j."""
    lines = []
    for i in reversed(range(degree + 1)):
        lines += [f"row = {name}_{i}_{degree - i};", f"slope = {vector}(0.0);"]
        for j in reversed(range(degree - i)):
            lines += ["slope = slope * s.y + row;", f"row = row * s.y + {name}_{i}_{j};"]
        lines += ["by_x = by_x * s.x + value;", "by_y = by_y * s.x + slope;", "value = value * s.x + row;"]
    return "\n".join(f"    {line}" for line in lines)


def _contains_source(name: str, polynomial: Polynomial) -> str:
    vector = f"vec{len(polynomial.box.low)}"
    return f"""
bool {name}_contains({vector} inputs)
{{
    return all(lessThanEqual(abs({_scaled(polynomial, slice(None))}), {vector}({_number(1.0 + 2.0 * BOX_SLACK)})));
}}
"""


def _monomials(polynomial: Polynomial) -> FloatArray:
    """Coefficients of the powers of the scaled variables: (degree + 1,) * variables + (outputs,)."""
    size, variables = polynomial.degree + 1, len(polynomial.box.low)
    table = np.zeros((size,) * variables + (polynomial.coefficients.shape[1],))
    table[tuple(exponents(variables, polynomial.degree).T)] = polynomial.coefficients
    powers_of_chebyshev = np.zeros((size, size))
    for order, row in enumerate(powers_of_chebyshev):
        row[: order + 1] = cheb2poly(np.eye(size)[order, : order + 1])
    for axis in range(variables):
        table = np.moveaxis(np.tensordot(powers_of_chebyshev, table, axes=(0, axis)), 0, axis)
    return table


def _nested(table: FloatArray, variables: list[str], degree: int) -> str:
    """Expression of the powers of total degree <= `degree`, nested in the first variable outermost."""
    if not variables:
        return _literal(table)
    terms = [_nested(table[power], variables[1:], degree - power) for power in range(degree + 1)]
    expression = terms.pop()
    while terms:
        expression = f"{terms.pop()} + {variables[0]} * ({expression})"
    return expression


def _scaled(polynomial: Polynomial, axes: slice) -> str:
    centre = 0.5 * (polynomial.box.low + polynomial.box.high)
    return f"(inputs - {_literal(centre[axes])}) * {_literal(_per_unit(polynomial)[axes])}"


def _per_unit(polynomial: Polynomial) -> FloatArray:
    return np.asarray(2.0 / (polynomial.box.high - polynomial.box.low))


def _vector(size: int) -> str:
    return "float" if size == 1 else f"vec{size}"


def _literal(values: FloatArray) -> str:
    return f"{_vector(len(values))}({', '.join(map(_number, values))})"


def _number(value: float) -> str:
    """Nine digits name one float32."""
    return f"{value:.8e}"
