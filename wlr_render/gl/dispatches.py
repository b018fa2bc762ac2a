"""Compute shaders of a context: the work of several eyes is collected, and one dispatch of each shader serves them."""

import contextlib
import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from wlr_render.gl.native_contexts import CurrentContext
from wlr_render.gl.programs import bind_textures, of_eyes, set_uniforms

GROUP = 8
"""Side of a compute shader's work group, in texels."""

_SAMPLERS_OF_EYE = 14  # samplers of the largest shader, the warp with overlays
_MOST_SAMPLERS = 0x91BC  # GL_MAX_COMPUTE_TEXTURE_IMAGE_UNITS


@dataclass(frozen=True, eq=False)
class Dispatch:
    """A compute shader that fills textures of one eye.

    Attributes:
        program: ModernGL's shader, from `GlContext.compute_program`.
        targets: ModernGL textures of one size, the shader's images 0, 1 and so on.
        textures: textures by the name of their sampler; a list for an array of samplers.
        uniforms: values by name: as of `set_uniforms`.
    """

    program: Any
    targets: Sequence[Any]
    textures: Mapping[str, Any]
    uniforms: Mapping[str, Any]

    def is_like(self, other: "Dispatch") -> bool:
        """Return whether one dispatch can serve both."""
        return self.program is other.program and len(self.targets) == len(other.targets)


Work = Dispatch | Callable[[], None]
"""A dispatch, or other commands that need the results of dispatches."""


class Dispatches:
    """Runs dispatches at once or, in a block `together`, at its end, where one dispatch serves several eyes.

    Attributes:
        eyes: number of eyes that a shader serves at once: two, but one where the driver has too few samplers, and on
            software renderers, which compile shaders for two eyes for minutes. Change it only before any is compiled.
    """

    def __init__(self, ctx: Any, current: CurrentContext, is_software: bool) -> None:
        """Prepare for a context that is current."""
        self._ctx = ctx
        self._collected: list[list[Work]] | None = None
        most = ctypes.c_int(0)
        current.function("glGetIntegerv", ctypes.c_uint, ctypes.c_void_p)(_MOST_SAMPLERS, ctypes.addressof(most))
        self.eyes = 1 if is_software or most.value < 2 * _SAMPLERS_OF_EYE else 2
        types = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
        self._bind_images = current.function("glBindImageTextures", *types)

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        """Collect work in this block, and run it at the block's end; an error drops it."""
        collected: list[list[Work]] = []
        self._collected = collected
        try:
            yield
        finally:
            self._collected = None
        while longest := max(collected, key=len, default=None):
            first = longest[0]
            if isinstance(first, Dispatch):
                self._run(self._taken_with(first, collected))
            else:
                del longest[0]
                first()

    def next_eye(self) -> None:
        """Begin the work of an eye, which needs nothing of the eyes before it."""
        if self._collected is not None:
            self._collected.append([])

    def add(self, work: Work) -> None:
        """Run work now, or in a block `together` at its end, after the work of the same eye that was added before."""
        if self._collected is not None:
            self._collected[-1].append(work)
        elif isinstance(work, Dispatch):
            self._run([work])
        else:
            work()

    def _run(self, works: Sequence[Dispatch]) -> None:
        """Run dispatches of one shader, at most one for each eye; later commands see their results."""
        first, program = works[0], works[0].program
        slots = [*works, *[first] * (self.eyes - len(works))]  # an unused slot must have valid textures
        bind_textures(program, **{of_eyes(name): _flat(name, slots) for name in first.textures})
        set_uniforms(program, **{of_eyes(name): [each.uniforms[name] for each in slots] for name in first.uniforms})
        images = [each.targets[k].glo for k in range(len(first.targets)) for each in slots]
        self._bind_images(0, len(images), (ctypes.c_uint * len(images))(*images))
        sizes = [each.targets[0].size for each in works]
        program.run(
            -(-max(width for width, _ in sizes) // GROUP), -(-max(height for _, height in sizes) // GROUP), len(works)
        )
        self._ctx.memory_barrier()

    def _taken_with(self, first: Dispatch, collected: Sequence[list[Work]]) -> list[Dispatch]:
        """Take the dispatches that one can serve together with the first, and itself, from the eyes' lists."""
        works: list[Dispatch] = []
        for of_eye in collected:
            head = of_eye[0] if of_eye else None
            if isinstance(head, Dispatch) and head.is_like(first) and len(works) < self.eyes:
                works.append(head)
                del of_eye[0]
        return works


def _flat(name: str, slots: Sequence[Dispatch]) -> list[Any]:
    """Return the textures of a sampler for all eyes, one eye's after the other."""
    given = [each.textures[name] for each in slots]
    return [texture for each in given for texture in each] if isinstance(given[0], list) else given
