"""GLSL source of a `Polynomial`, its coefficients written as literals.

Compilers turn literals into the operands of multiply-adds; coefficients in a buffer cost a read each, which makes
software renderers ten times slower. The Chebyshev series is multiplied out to monomials of the same scaled variables
and nested (Horner). At the degrees of the models, with inputs scaled to -1..1, that loses a few of float32's rounding
units: tests/warps/test_shader_polynomial.py has the measured errors.
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly

from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import SCALED_LIMIT, Polynomial

_COMPONENTS = "xyzw"
_HELD = 2
_STEP = 1.0 / 128.0  # step of central differences, in scaled units; balances float32 rounding and the error of order 8


@dataclass(frozen=True, eq=False)
class Thinned:
    """A polynomial without its smallest terms.

    Attributes:
        polynomial: with the other terms.
        bound: (outputs,) of the error everywhere in the box: the sum of the dropped coefficients' sizes, as |T_k| <= 1.
    """

    polynomial: Polynomial
    bound: FloatArray


def thinned(polynomial: Polynomial, tolerance: FloatArray) -> Thinned:
    """Drop the smallest terms as long as the error stays below `tolerance` (outputs,)."""
    size = np.abs(polynomial.coefficients)
    ascending = np.argsort((size / tolerance).max(axis=1), kind="stable")
    bounds = np.cumsum(size[ascending], axis=0)
    count = min(int(np.sum(np.all(bounds <= tolerance, axis=1))), len(size) - 1)
    kept = np.sort(ascending[count:])
    thin = Polynomial(polynomial.orders[kept], polynomial.box, polynomial.coefficients[kept])
    return Thinned(thin, np.asarray(bounds[count - 1] if count else np.zeros(size.shape[1])))


def value_source(name: str, polynomial: Polynomial) -> str:
    """GLSL of `vecK NAME(vecN inputs)` and of `bool NAME_contains(vecN inputs)`, the polynomial's `box.contains`.

    Args:
        name: of the function.
        polynomial: of N = 2 to 4 variables, with K = 1 to 4 outputs.
    """
    variables, outputs = len(polynomial.box.low), polynomial.coefficients.shape[1]
    value = _nested(_monomials(polynomial), [f"s.{c}" for c in _COMPONENTS[:variables]])
    return f"""
{_vector(outputs)} {name}(vec{variables} inputs)
{{
    {_vector(outputs)} value = {_vector(outputs)}(0.0);
{_continued(polynomial, slice(None), [f"value += weight * ({value});"])}
    return value;
}}
{_contains_source(name, polynomial)}"""


def held_source(name: str, polynomial: Polynomial) -> str:
    """GLSL for a solve in the last two of four variables, in which the first two stay as they are.

    `void NAME_hold(vec2 inputs)` multiplies the first two out once per pixel; `vecK NAME(vec2 inputs, out matKx2)` is
    then a polynomial of the last two only (21 terms instead of 126 at degree 5), with its Jacobian: column j is the
    derivative by input j, in the inputs' units. `bool NAME_contains(vec4 inputs)` is as in `value_source`. Where held
    and other inputs both leave the box, the product of their excursions adds to the first order.

    Args:
        name: of the functions.
        polynomial: of four variables, with K = 2 to 4 outputs.
    """
    outputs, table = polynomial.coefficients.shape[1], _monomials(polynomial)
    vector = _vector(outputs)
    powers = [(int(i), int(j)) for i, j in np.argwhere(table.any(axis=(0, 1, 4)))] or [(0, 0)]
    names = [f"{name}_{i}_{j}" for i, j in powers]
    cleared = "\n".join(f"    {each} = {vector}(0.0);" for each in names)
    held = [
        f"{each} += weight * ({_nested(table[:, :, i, j], ['s.x', 's.y'])});"
        for each, (i, j) in zip(names, powers, strict=True)
    ]
    per_unit = _literal(polynomial.box.per_unit[_HELD:])
    return f"""
{vector} {", ".join(names)};

void {name}_hold(vec2 inputs)
{{
{cleared}
{_continued(polynomial, slice(0, _HELD), held)}
}}

{vector} {name}(vec2 inputs, out mat2x{outputs} jacobian)
{{
    vec2 scaled = {_scaled(polynomial, slice(_HELD, None))};
    vec2 s = {_border("vec2")};
    vec2 beyond = scaled - s;
    {vector} row, slope, value = {vector}(0.0), by_x = {vector}(0.0), by_y = {vector}(0.0), by_both = {vector}(0.0);
{_horner_with_slopes(name, vector, powers)}
    value += by_x * beyond.x + by_y * beyond.y;
    // Outside, the nearest point of the box still moves with the other input.
    by_x += beyond.x == 0.0 ? by_both * beyond.y : {vector}(0.0);
    by_y += beyond.y == 0.0 ? by_both * beyond.x : {vector}(0.0);
    jacobian = mat2x{outputs}(by_x * {per_unit}.x, by_y * {per_unit}.y);
    return value;
}}
{_contains_source(name, polynomial)}"""


def _continued(polynomial: Polynomial, axes: slice, statements: list[str]) -> str:
    """Statements that add up `weight` times an expression of `s`, the scaled `inputs`: first order outside the box.

    The slope along the excursion is a central difference. It is another turn of a loop, so that it costs nothing
    inside: software renderers skip turns, but no branches.
    """
    vector = f"vec{len(polynomial.box.low[axes])}"
    body = "\n".join(f"        {statement}" for statement in statements)
    return f"""\
    {vector} scaled = {_scaled(polynomial, axes)};
    {vector} border = {_border(vector)};
    {vector} beyond = scaled - border;
    float far = length(beyond);
    int turns = far > 0.0 ? 3 : 1;
    for (int turn = 0; turn < turns; ++turn) {{
        float side = turn == 0 ? 0.0 : turn == 1 ? 1.0 : -1.0;
        {vector} s = turn == 0 ? border : border + side * {_number(_STEP)} / far * beyond;
        float weight = turn == 0 ? 1.0 : side * far * {_number(0.5 / _STEP)};
{body}
    }}"""


def _border(vector: str) -> str:
    return f"clamp(scaled, {vector}({_number(-SCALED_LIMIT)}), {vector}({_number(SCALED_LIMIT)}))"


def _horner_with_slopes(name: str, vector: str, powers: list[tuple[int, int]]) -> str:
    """Statements that leave value, by_x, by_y and by_both of the sum over `powers` i, j of NAME_i_j s.x^i s.y^j."""
    lines = []
    for i in reversed(range(max(i for i, _ in powers) + 1)):
        columns = [j for row, j in powers if row == i]
        lines += [f"row = {f'{name}_{i}_{max(columns)}' if columns else f'{vector}(0.0)'};", f"slope = {vector}(0.0);"]
        for j in reversed(range(max(columns, default=0))):
            lines += ["slope = slope * s.y + row;", f"row = row * s.y{f' + {name}_{i}_{j}' if j in columns else ''};"]
        lines += ["by_both = by_both * s.x + by_y;", "by_x = by_x * s.x + value;"]
        lines += ["by_y = by_y * s.x + slope;", "value = value * s.x + row;"]
    return "\n".join(f"    {line}" for line in lines)


def _contains_source(name: str, polynomial: Polynomial) -> str:
    vector = f"vec{len(polynomial.box.low)}"
    return f"""
bool {name}_contains({vector} inputs)
{{
    return all(lessThanEqual(abs({_scaled(polynomial, slice(None))}), {vector}({_number(SCALED_LIMIT)})));
}}
"""


def _monomials(polynomial: Polynomial) -> FloatArray:
    """Coefficients of the powers of the scaled variables: (highest order + 1) of each, outputs."""
    sizes = polynomial.orders.max(axis=0) + 1
    table = np.zeros((*sizes, polynomial.coefficients.shape[1]))
    np.add.at(table, tuple(polynomial.orders.T), polynomial.coefficients)
    for axis, size in enumerate(sizes):
        powers_of_chebyshev = np.zeros((size, size))
        for order, row in enumerate(powers_of_chebyshev):
            row[: order + 1] = cheb2poly(np.eye(size)[order, : order + 1])
        table = np.moveaxis(np.tensordot(powers_of_chebyshev, table, axes=(0, axis)), 0, axis)
    return table


def _nested(table: FloatArray, variables: list[str]) -> str:
    """Expression of the powers that are there, nested in the first variable outermost."""
    if not variables:
        return _literal(table)
    present = [power for power, rest in enumerate(table) if rest.any()] or [0]
    expression = _nested(table[present[-1]], variables[1:])
    for power in reversed(range(present[-1])):
        inner = f"{variables[0]} * ({expression})"
        expression = f"{_nested(table[power], variables[1:])} + {inner}" if power in present else inner
    return expression


def _scaled(polynomial: Polynomial, axes: slice) -> str:
    centre = 0.5 * (polynomial.box.low + polynomial.box.high)
    return f"(inputs - {_literal(centre[axes])}) * {_literal(polynomial.box.per_unit[axes])}"


def _vector(size: int) -> str:
    return "float" if size == 1 else f"vec{size}"


def _literal(values: FloatArray) -> str:
    return f"{_vector(len(values))}({', '.join(map(_number, values))})"


def _number(value: float) -> str:
    """Nine digits name one float32."""
    return f"{value:.8e}"
