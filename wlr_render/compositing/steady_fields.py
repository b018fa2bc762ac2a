"""The rays of one eye while its pupil rests: solved once."""

from collections.abc import Sequence
from typing import Generic, Protocol, TypeVar

from wlr_render.numerics.arrays import FloatArray

FieldT = TypeVar("FieldT", covariant=True)


class FieldSolve(Protocol[FieldT]):
    """`pixel_solve.PixelSolve` or `gpu_field.GpuSolve`."""

    def solve(self, viewpoint: FloatArray) -> FieldT:
        """The field at a viewpoint (3,)."""

    def forget(self) -> None:
        """Start the next solve cold."""


class SteadyFields(Generic[FieldT]):
    """The fields of an eye's channels, solved anew only where the pupil has moved."""

    def __init__(self, solves: Sequence[FieldSolve[FieldT]]) -> None:
        self._solves = solves
        self._solved: tuple[FloatArray, list[FieldT]] | None = None

    def at(self, viewpoint: FloatArray) -> list[FieldT]:
        """One field for each channel; (3,) is kept to compare with, so that nobody may write into it."""
        if self._solved is None or (self._solved[0] != viewpoint).any():
            self._solved = None  # a solve that fails leaves fields of two viewpoints
            self._solved = viewpoint, [solve.solve(viewpoint) for solve in self._solves]
        return self._solved[1]

    def forget(self) -> None:
        """Solve the next fields cold."""
        self._solved = None
        for solve in self._solves:
            solve.forget()
