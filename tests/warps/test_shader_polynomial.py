import numpy as np
import pytest
from fitted_eyes import fitted_terms
from hardware import FLOAT, allowed

from wlr_render.geometry.directions import ARCMIN
from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.numerics.arrays import FloatArray, IntArray
from wlr_render.numerics.polynomial import BOX_SLACK, Box, Polynomial, limited_orders, total_degree
from wlr_render.warp.shader_polynomial import held_source, thinned, value_source

pytestmark = pytest.mark.gl

DISPLAY_BOX = Box(np.array([0.0, 0.0, 0.025, -0.006]), np.array([1440.0, 1600.0, 0.039, 0.006]))
SHADER = """#version 430
uniform sampler2D table;
layout(location = 0) out vec4 answer[2];
{functions}
void main()
{{
    vec4 inputs = texelFetch(table, ivec2(gl_FragCoord.xy), 0);
    {body}
}}
"""


def run(context: GlContext, functions: str, body: str, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The shader's two answers (n, 4) each for inputs (n, variables)."""
    padded = np.zeros((1, len(inputs), 4), np.float32)
    padded[0, :, : inputs.shape[1]] = inputs
    size = len(inputs), 1
    with context.drawing() as ctx:
        table, first, second = (context.target(size, 4, "f4") for _ in range(3))
        table.write(padded)
        vertex = "#version 430\nvoid main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0); }"  # noqa: E501
        program = ctx.program(vertex_shader=vertex, fragment_shader=SHADER.format(functions=functions, body=body))
        context.framebuffer([first, second]).use()
        gl.bind_textures(program, table=table)
        ctx.vertex_array(program, []).render(vertices=3)
        return gl.read(first, np.float32)[0].astype(float), gl.read(second, np.float32)[0].astype(float)


def inputs_in(box: Box, count: int = 4000, grown: float = 1.0) -> FloatArray:
    """Random inputs as the shader gets them, the corners of the box among them, which may be grown."""
    unit = np.random.default_rng(1).uniform(-1, 1, (count, len(box.low))) * grown
    unit[:200] = np.sign(unit[:200]) * grown
    inputs = 0.5 * (box.low + box.high) + 0.5 * unit * (box.high - box.low)
    return inputs.astype(np.float32).astype(float)


def seen(inputs: FloatArray) -> FloatArray:
    """Tangents under which a curved virtual image half a metre away is seen, with a strong distortion and swim."""
    u, v, x, y = inputs.T
    a, b = 0.35 * (u / 720 - 1), 0.35 * (1 - v / 800)
    depth = 0.5 - 0.6 * (a * a + b * b) - 3.0 * x * a
    return np.asarray(np.stack([a * (1 + 2 * b * b) - x, b * (1 + a) - y], axis=-1) / depth[:, None])


HELD_BODY = """
    mat2 jacobian;
    shown_hold(inputs.xy);
    answer[0] = vec4(shown(inputs.zw, jacobian), 0.0, 0.0);
    answer[1] = vec4(jacobian[0], jacobian[1]);"""
MANY_PIXEL_ORDERS = limited_orders(2, 8, 2, 5, 8)


@pytest.mark.parametrize(
    "orders", [*(total_degree(4, degree) for degree in range(3, 8)), MANY_PIXEL_ORDERS, limited_orders(2, 2, 2, 6, 6)]
)
def test_tangents_and_slopes_in_float32_are_the_polynomials(gl_context: GlContext, orders: IntArray) -> None:
    polynomial = fitted_terms(seen, DISPLAY_BOX, orders)
    inputs = inputs_in(DISPLAY_BOX)
    answer, columns = run(gl_context, held_source("shown", polynomial), HELD_BODY, inputs)
    value, jacobian = polynomial.with_jacobian(inputs, axes=(2, 3))
    worst_arcmin = np.abs(answer[:, :2] - value).max() / ARCMIN
    print(f"{len(orders)} terms: worst error {worst_arcmin:.5f} arcmin of tangents up to {np.abs(value).max():.2f}")
    # Two roundings of the value for each degree of each variable, where a compiler orders the sums as it likes.
    rounded = 2 * float(orders.max(axis=0).sum()) * FLOAT * float(np.abs(value).max())
    assert worst_arcmin < allowed(gl_context, 0.003, rounded / ARCMIN)
    np.testing.assert_allclose(columns.reshape(-1, 2, 2).swapaxes(1, 2), jacobian, atol=2e-5 * np.abs(jacobian).max())


def test_outside_the_box_the_shader_continues_as_the_polynomial(gl_context: GlContext) -> None:
    polynomial = fitted_terms(seen, DISPLAY_BOX, MANY_PIXEL_ORDERS)
    inputs = inputs_in(DISPLAY_BOX, grown=1.2)
    exact, jacobian = polynomial.with_jacobian(inputs, axes=(2, 3))
    value, _ = run(gl_context, value_source("f", polynomial), "answer[0] = vec4(f(inputs), 0.0, 0.0);", inputs)
    assert np.abs(value[:, :2] - exact).max() / ARCMIN < 0.2
    held, columns = run(gl_context, held_source("shown", polynomial), HELD_BODY, inputs)
    slope = columns.reshape(-1, 2, 2).swapaxes(1, 2)
    left = np.abs(DISPLAY_BOX.scaled(inputs)) > 1.0 + 2.0 * BOX_SLACK
    both = left[:, :2].any(axis=1) & left[:, 2:].any(axis=1)
    error = np.abs(held[:, :2] - exact).max(axis=1) / ARCMIN
    assert error[~both].max() < 0.2
    np.testing.assert_allclose(slope[~both], jacobian[~both], atol=1e-4 * np.abs(jacobian).max())
    # A fifth beyond both boxes the shader goes on with the product of both excursions, too.
    assert 0.1 < both.mean() < 0.9
    assert error[both].max() < 30


def test_dropped_terms_change_no_more_than_the_bound(gl_context: GlContext) -> None:
    orders = limited_orders(2, 8, 2, 5, 8)
    coefficients = np.random.default_rng(3).normal(size=(len(orders), 2)) * np.exp(-2.0 * orders.sum(axis=1))[:, None]
    polynomial, tolerance = Polynomial(orders, DISPLAY_BOX, coefficients), np.array([1e-4, 3e-4])
    thin = thinned(polynomial, tolerance)
    assert 100 < len(thin.polynomial.orders) < 300
    assert np.all(thin.bound <= tolerance)
    assert np.any(thin.bound > 0.9 * tolerance)
    corners = 0.5 * (np.array(np.meshgrid(*[[-1, 1]] * 4)).reshape(4, -1).T + 1) * (DISPLAY_BOX.high - DISPLAY_BOX.low)
    inputs = np.concatenate([inputs_in(DISPLAY_BOX), corners + DISPLAY_BOX.low])
    worst = np.abs(thin.polynomial(inputs) - polynomial(inputs)).max(axis=0)
    assert np.all(worst <= thin.bound)
    assert np.all(worst > 0.02 * thin.bound)
    nothing = thinned(polynomial, np.full(2, 1e-30))
    np.testing.assert_array_equal(nothing.polynomial.orders, orders)
    np.testing.assert_array_equal(nothing.bound, 0.0)
    inside = inputs_in(DISPLAY_BOX)
    answer, _ = run(gl_context, held_source("shown", thin.polynomial), HELD_BODY, inside)
    np.testing.assert_allclose(answer[:, :2], thin.polynomial(inside), atol=2e-6)
