"""Polynomials over any table of terms in scaled variables, with their Jacobian.

A term is a product of Chebyshev polynomials T_k of the variables scaled to -1..1: well conditioned at order 7 and
above, so that rank checks are reliable. Two groups of variables may have separate order limits (`limited_orders`),
because pixels are plentiful and camera positions are expensive.

Hundreds of terms in four or five variables share some dozens of products of the first variables and of the last ones.
With f and g these products, the value is sum_ij f_i(first) C_ij g_j(last): one matrix product and a short sum, instead
of a product of columns per term. A caller that varies only some of the variables holds the others fixed
(`Polynomial.held`) and pays for the short sum alone.

Outside its box, grown by `BOX_SLACK`, a polynomial continues to first order from the nearest point of the box, because
high orders would explode there: its value is the value at that point + Jacobian x excursion. The Jacobian remains the
derivative of the value, so that Newton's method converges there, too; along the excursion it is that point's Jacobian.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import comb

import numpy as np

from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

HIGHEST_ORDER = 50
"""Largest order of a variable in a term of a file: no fit comes near it."""
BOX_SLACK = 1e-3
"""Share of its size by which a fitted box grows, so that samples on its border count as inside."""
SCALED_LIMIT = 1.0 + 2.0 * BOX_SLACK
"""Size of a scaled variable at the border of the box grown by `BOX_SLACK`."""

_CHUNK = 2_048  # rows per block, so few that their products stay in the processor's cache
_SLOW = 12  # cost of one element-wise multiplication, in multiplications of a matrix product


def term_count(variables: int, degree: int) -> int:
    """Return the number of terms of total degree up to `degree`: C(variables + degree, degree)."""
    return comb(variables + degree, degree)


@lru_cache(maxsize=64)
def total_degree(variables: int, degree: int) -> IntArray:
    """Return (terms, variables) orders of all terms of total order <= `degree`, ordered by total order; read-only."""
    rows = itertools.product(range(degree + 1), repeat=variables)
    return _order_table((row for row in rows if sum(row) <= degree), variables)


@lru_cache(maxsize=64)
def limited_orders(first: int, first_limit: int, second: int, second_limit: int, total: int) -> IntArray:
    """Return (terms, first + second) orders of terms with separate limits, ordered like `total_degree`; read-only.

    Args:
        first, second: numbers of variables.
        first_limit, second_limit: limits of the total order in the first and in the second variables.
        total: limit of the total order in all variables.
    """
    heads = total_degree(first, min(first_limit, total)).tolist()
    tails = total_degree(second, min(second_limit, total)).tolist()
    rows = (tuple(head + tail) for head in heads for tail in tails if sum(head) + sum(tail) <= total)
    return _order_table(rows, first + second)


def _order_table(rows: Iterable[tuple[int, ...]], variables: int) -> IntArray:
    ordered = sorted(rows, key=lambda row: (sum(row), row))
    table = np.array(ordered, dtype=np.int64).reshape(len(ordered), variables)
    table.setflags(write=False)
    return table


@dataclass(frozen=True)
class Box:
    """An axis-aligned box of inputs, scaled to -1..1 inside.

    Attributes:
        low, high: (variables,) in the inputs' own units.
    """

    low: FloatArray
    high: FloatArray

    @classmethod
    def around(cls, inputs: FloatArray) -> "Box":
        """Return the bounding box of samples (n, variables); an axis without extent gets a width of one unit."""
        low, high = inputs.min(axis=0), inputs.max(axis=0)
        flat = high - low <= 1e-12 * np.maximum(1.0, np.abs(high))
        return cls(np.where(flat, low - 0.5, low), np.where(flat, high + 0.5, high))

    @property
    def per_unit(self) -> FloatArray:
        """(variables,) scaled units per unit of the inputs."""
        return np.asarray(2.0 / (self.high - self.low))

    def scaled(self, inputs: FloatArray) -> FloatArray:
        """Scale inputs (..., variables) to -1..1 inside the box."""
        return np.asarray((2.0 * inputs - self.low - self.high) / (self.high - self.low))

    def contains(self, inputs: FloatArray, slack: float = BOX_SLACK) -> BoolArray:
        """Return whether inputs (..., variables) lie in the box grown by `slack` of its size: (...) bool."""
        return np.asarray(np.all(np.abs(self.scaled(inputs)) <= 1.0 + 2.0 * slack, axis=-1))

    def places(self, count: int) -> FloatArray:
        """Return pseudo-random places (count, variables) in the box, the same at each call."""
        share = np.random.default_rng(0).uniform(size=(count, len(self.low)))
        return np.asarray(self.low + share * (self.high - self.low))

    def select(self, axes: Sequence[int]) -> "Box":
        """Return the box of some of the variables."""
        return Box(self.low[list(axes)], self.high[list(axes)])


@dataclass(frozen=True)
class _Products:
    """Products of Chebyshev polynomials of some variables, for n inputs.

    Attributes:
        value: (products, n) at the nearest point of the box to each input.
        slopes: (products, n) derivative there by each scaled variable; empty if not needed and all inputs are inside.
        beyond: (variables, n) vector from that point to the input; None if all inputs are inside.
        bends: (products, n) derivative of `excess` minus the slope, by each scaled variable; empty like `slopes`, or if
            all inputs are inside.
    """

    value: FloatArray
    slopes: list[FloatArray]
    beyond: FloatArray | None
    bends: list[FloatArray]

    @classmethod
    def compute(cls, orders: IntArray, box: Box, inputs: FloatArray, slopes: bool = False) -> "_Products":
        """Compute the products of orders (products, variables) at inputs (n, variables)."""
        x, beyond = np.ascontiguousarray(box.scaled(inputs).T), None
        if x.size and not np.abs(x).max() <= SCALED_LIMIT:  # also true for NaN
            inside = np.clip(x, -SCALED_LIMIT, SCALED_LIMIT)
            x, beyond, slopes = inside, x - inside, True
        t = np.empty((int(orders.max(initial=0)) + 1, *x.shape))
        t[0] = 1.0
        if len(t) > 1:
            t[1] = x
        for k in range(2, len(t)):
            t[k] = 2.0 * x * t[k - 1] - t[k - 2]
        factors = [t[orders[:, axis], axis] for axis in range(len(x))]
        value = _product(factors, (len(orders), x.shape[1]))
        if not slopes:
            return cls(value, [], beyond, [])
        d = np.zeros_like(t)
        if len(t) > 1:
            d[1] = 1.0
        for k in range(2, len(t)):
            d[k] = 2.0 * t[k - 1] + 2.0 * x * d[k - 1] - d[k - 2]
        slopes_of = [d[orders[:, axis], axis] for axis in range(len(x))]

        def differentiated(*axes: int) -> FloatArray:
            mixed = [slopes_of[axis] if axis in axes else factor for axis, factor in enumerate(factors)]
            return _product(mixed, value.shape)

        bends = []
        if beyond is not None:
            for axis in range(len(x)):
                others = [other for other in range(len(x)) if other != axis]
                bend = sum((beyond[other] * differentiated(axis, other) for other in others), np.zeros_like(value))
                bends.append(np.where(beyond[axis] == 0, bend, 0.0))
        return cls(value, [differentiated(axis) for axis in range(len(x))], beyond, bends)

    @property
    def excess(self) -> FloatArray:
        """Linear continuation outside the box, (products, n): slopes times excursion."""
        assert self.beyond is not None
        parts = (slope * beyond for slope, beyond in zip(self.slopes, self.beyond, strict=True))
        return np.asarray(sum(parts, start=np.zeros_like(self.value)))


def _product(factors: list[FloatArray], shape: tuple[int, int]) -> FloatArray:
    if not factors:
        return np.ones(shape)
    result = factors[0]
    for factor in factors[1:]:
        result = result * factor
    return result


def basis(inputs: FloatArray, orders: IntArray, box: Box) -> FloatArray:
    """Return the design matrix (n, terms) of samples (n, variables): the value of each term, not linearised outside.

    Args:
        inputs: (n, variables).
        orders: (terms, variables), see `Polynomial`.
        box: box that scales the inputs.
    """
    middle = (orders.shape[1] + 1) // 2
    (first, row), (second, column) = _distinct(orders[:, :middle]), _distinct(orders[:, middle:])
    axes = range(orders.shape[1])
    head = _Products.compute(first, box.select(axes[:middle]), inputs[:, :middle])
    tail = _Products.compute(second, box.select(axes[middle:]), inputs[:, middle:])
    result = head.value[row] * tail.value[column]
    if head.beyond is not None:
        result += head.excess[row] * tail.value[column]
    if tail.beyond is not None:
        result += head.value[row] * tail.excess[column]
    return np.ascontiguousarray(result.T)


def _distinct(orders: IntArray) -> tuple[IntArray, IntArray]:
    """Return the distinct rows of (terms, variables), and for each term the index of its row; do not modify them."""
    return _distinct_rows(orders.astype(np.int64).tobytes(), orders.shape)


@lru_cache(maxsize=256)
def _distinct_rows(content: bytes, shape: tuple[int, int]) -> tuple[IntArray, IntArray]:
    if shape[1] == 0:
        return np.zeros((1, 0), np.int64), np.zeros(shape[0], np.int64)
    rows, index = np.unique(np.frombuffer(content, np.int64).reshape(shape), axis=0, return_inverse=True)
    return rows, index.reshape(-1)


@dataclass(frozen=True)
class _Split:
    """Terms as products of one factor of the held and one of the free variables.

    Attributes:
        held_axes, free_axes: the held and the free variables, together all.
        held_orders, free_orders: (factors, variables) orders of their factors.
        table: (outputs * free factors, held factors) coefficients; zero for absent terms.
    """

    held_axes: list[int]
    free_axes: list[int]
    held_orders: IntArray
    free_orders: IntArray
    table: FloatArray

    @classmethod
    def from_terms(cls, orders: IntArray, coefficients: FloatArray, held_axes: Sequence[int]) -> "_Split":
        if len(orders) == 0:  # the zero polynomial
            orders, coefficients = np.zeros((1, orders.shape[1]), np.int64), np.zeros((1, coefficients.shape[1]))
        held = list(held_axes)
        free = [axis for axis in range(orders.shape[1]) if axis not in held]
        held_orders, row = _distinct(orders[:, held])
        free_orders, column = _distinct(orders[:, free])
        table = np.zeros((len(free_orders), len(held_orders), coefficients.shape[1]))
        np.add.at(table, (column, row), coefficients)
        by_output = np.ascontiguousarray(np.moveaxis(table, 2, 0))
        return cls(held, free, held_orders, free_orders, by_output.reshape(-1, len(held_orders)))

    @property
    def cost(self) -> int:
        """Cost of an evaluation, in multiplications of a matrix product."""
        products = len(self.held_orders) * len(self.held_axes) + len(self.free_orders) * len(self.free_axes)
        return self.table.size + _SLOW * (len(self.table) + products)


class HeldPolynomial:
    """A polynomial some of whose variables are held, row by row; `Polynomial.held` makes one."""

    def __init__(self, split: _Split, box: Box, inputs: FloatArray) -> None:
        """Hold the rows of inputs (n, held variables)."""
        self._orders, self._box = split.free_orders, box.select(split.free_axes)
        factors = _Products.compute(split.held_orders, box.select(split.held_axes), inputs)
        shape = (len(split.table) // len(self._orders), len(self._orders), len(inputs))
        self._border = (split.table @ factors.value).reshape(shape)
        beyond = factors.beyond is not None
        self._here = (split.table @ (factors.value + factors.excess)).reshape(shape) if beyond else self._border

    def __call__(self, inputs: FloatArray, index: IntArray | None = None) -> FloatArray:
        """Return the values (m, outputs) at the free variables (m, axes ascending).

        Args:
            inputs: (m, free variables).
            index: (m,) held row of each input, strictly ascending; None for all rows.
        """
        factors = _Products.compute(self._orders, self._box, inputs)
        value = _summed(_rows(self._here, index), factors.value)
        if factors.beyond is not None:
            value += _summed(_rows(self._border, index), factors.excess)
        return value.T

    def with_jacobian(self, inputs: FloatArray, index: IntArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the value (m, outputs) and Jacobian (m, outputs, free variables), see `__call__`."""
        factors = _Products.compute(self._orders, self._box, inputs, slopes=True)
        border = _rows(self._border, index)
        here = border if self._here is self._border else _rows(self._here, index)
        value = _summed(here, factors.value)
        if factors.beyond is not None:
            value += _summed(border, factors.excess)
        jacobian = np.empty((len(inputs), len(value), inputs.shape[1]))
        for axis, (slope, per_unit) in enumerate(zip(factors.slopes, self._box.per_unit, strict=True)):
            derivative = _summed(here, slope)
            if factors.beyond is not None:
                fixed = factors.beyond[axis] != 0  # there, the nearest point of the box does not move with the variable
                derivative = np.where(fixed, _summed(border, slope), derivative) + _summed(border, factors.bends[axis])
            np.multiply(derivative.T, per_unit, out=jacobian[..., axis])
        return value.T, jacobian


def _rows(coefficients: FloatArray, index: IntArray | None) -> FloatArray:
    """Return the rows of a strictly ascending index: the array itself if the index is as long."""
    if index is None or len(index) == coefficients.shape[2]:
        return coefficients
    return np.take(coefficients, index, axis=2)


def _summed(coefficients: FloatArray, factors: FloatArray) -> FloatArray:
    """Return (outputs, n) sums over the factors of coefficients (outputs, factors, n) x factors (factors, n)."""
    return np.asarray(np.einsum("ofn,fn->on", coefficients, factors))


@dataclass(frozen=True)
class Polynomial:
    """A vector-valued polynomial over `box`, continued to first order outside.

    Attributes:
        orders: (terms, variables) orders of the Chebyshev factors of each term.
        box: bounds of the fit; it also scales the variables.
        coefficients: (terms, outputs).
    """

    orders: IntArray
    box: Box
    coefficients: FloatArray

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return int(self.coefficients.shape[1])

    @property
    def numbers(self) -> int:
        """Number of numbers that a file stores."""
        return int(self.coefficients.size)

    @property
    def rounding(self) -> float:
        """Rounding error of the values, the smallest tolerance for solves."""
        return 0.0

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return the values (..., outputs) at inputs (..., variables)."""
        split = self._cheapest()

        def value(rows: FloatArray) -> tuple[FloatArray]:
            return (HeldPolynomial(split, self.box, rows[:, split.held_axes])(rows[:, split.free_axes]),)

        return _in_blocks(value, inputs)[0]

    def with_jacobian(self, inputs: FloatArray, axes: Sequence[int] | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the value (..., outputs) and Jacobian (..., outputs, axes) of (..., variables), in the inputs' units.

        Args:
            inputs: (..., variables).
            axes: the variables to differentiate by, or None for all.
        """
        by = list(range(inputs.shape[-1]) if axes is None else axes)
        first = self._cheapest()
        second = self._split(first.free_axes)

        def both(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
            jacobian = np.empty((len(rows), self.coefficients.shape[1], rows.shape[1]))
            for split in (first, second):
                if split is first or set(by) & set(split.free_axes):
                    held = HeldPolynomial(split, self.box, rows[:, split.held_axes])
                    value, jacobian[..., split.free_axes] = held.with_jacobian(rows[:, split.free_axes])
            return value, jacobian[..., by]

        value, jacobian = _in_blocks(both, inputs)
        return value, jacobian

    def plus(self, other: "Polynomial") -> "Polynomial":
        """Return the sum with a polynomial over the same box, which may have other terms."""
        orders, index = _distinct(np.concatenate([self.orders, other.orders]))
        coefficients = np.zeros((len(orders), self.coefficients.shape[1]))
        np.add.at(coefficients, index, np.concatenate([self.coefficients, other.coefficients]))
        return Polynomial(orders, self.box, coefficients)

    def held(self, axes: Sequence[int], inputs: FloatArray) -> HeldPolynomial:
        """Hold the variables `axes` at (n, axes); the result is a polynomial of the others, ascending."""
        return HeldPolynomial(self._split(axes), self.box, inputs)

    @cached_property
    def _splits(self) -> dict[tuple[int, ...], _Split]:
        return {}

    def _split(self, held_axes: Sequence[int]) -> _Split:
        key = tuple(held_axes)
        if key not in self._splits:
            self._splits[key] = _Split.from_terms(self.orders, self.coefficients, key)
        return self._splits[key]

    def _cheapest(self) -> _Split:
        """Return the cheapest split into held and free variables by order: pixel | place or place | direction."""
        variables = self.orders.shape[1]
        return min((self._split(range(cut)) for cut in range(1, variables + 1)), key=lambda split: split.cost)


def _in_blocks(function: Callable[[FloatArray], tuple[FloatArray, ...]], inputs: FloatArray) -> tuple[FloatArray, ...]:
    """Apply a function of (n, variables) block by block to (..., variables) and join the results."""
    flat = inputs.reshape(-1, inputs.shape[-1])
    starts = range(0, max(len(flat), 1), _CHUNK)
    parts = zip(*(function(flat[start : start + _CHUNK]) for start in starts), strict=True)
    return tuple(np.concatenate(part).reshape(*inputs.shape[:-1], *part[0].shape[1:]) for part in parts)
