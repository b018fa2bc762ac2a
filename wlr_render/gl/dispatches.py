"""Compute shaders of a context: the work of several eyes is collected, and one dispatch of each shader serves them."""

import contextlib
import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from wlr_render.gl.native_contexts import CurrentContext
from wlr_render.gl.programs import MULTI_BIND_VERSION, bind_textures, of_eyes, set_uniforms

GROUP = 8
"""Side of a compute shader's work group, in texels."""

RGB10_A2 = 0x8059
_SAMPLERS_OF_EYE = 14  # samplers of the largest shader, the warp with overlays
_MOST_SAMPLERS = 0x91BC  # GL_MAX_COMPUTE_TEXTURE_IMAGE_UNITS


@dataclass(frozen=True, eq=False)
class Dispatch:
    """A compute shader that fills textures of one eye.

    Attributes:
        program: ModernGL's shader, from `GlContext.compute_program`.
        eyes: number of eyes that the shader serves at once.
        targets: ModernGL textures of one size, the shader's images 0, 1 and so on.
        textures: textures by the name of their sampler; a list for an array of samplers.
        uniforms: values by name: as of `set_uniforms`.
    """

    program: Any
    eyes: int
    targets: Sequence[Any]
    textures: Mapping[str, Any]
    uniforms: Mapping[str, Any]

    def is_like(self, other: "Dispatch") -> bool:
        """Return whether one dispatch can serve both."""
        return self.program is other.program and len(self.targets) == len(other.targets)


Work = Dispatch | Callable[[], None]
"""A dispatch, or other commands that need the results of dispatches."""


class Dispatches:
    """Runs dispatches at once; collects them in a block `together`, and merges those of several eyes.

    Attributes:
        eyes: number of eyes that a shader serves at once which is compiled now, see `serve`.
    """

    def __init__(self, ctx: Any, current: CurrentContext) -> None:
        """Prepare for a context that is current."""
        self._ctx, self.eyes = ctx, 1
        self._collected: list[list[Work]] | None = None
        self._get = current.function("glGetIntegerv", ctypes.c_uint, ctypes.c_void_p)
        types = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
        binds_several = ctx.version_code >= MULTI_BIND_VERSION
        self._bind = current.function("glBindImageTextures", *types) if binds_several else None

    def serve(self, eyes: int) -> None:
        """Compile shaders for this number of eyes from now on, if the driver has the samplers for them."""
        most = ctypes.c_int(0)
        self._get(_MOST_SAMPLERS, ctypes.addressof(most))
        self.eyes = eyes if most.value >= eyes * _SAMPLERS_OF_EYE else 1

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        """Collect work in this block; run it at the block's end, also after an error, because caches count on it."""
        collected: list[list[Work]] = []
        self._collected = collected
        try:
            yield
        finally:
            self._collected = None
            while longest := max(collected, key=len, default=None):
                first = longest[0]
                if isinstance(first, Dispatch):
                    self._run(_taken_with(first, collected))
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
        slots = [*works, *[first] * (first.eyes - len(works))]  # an unused slot must have valid textures
        bind_textures(program, **{of_eyes(name): _flat(name, slots) for name in first.textures})
        set_uniforms(program, **{of_eyes(name): [each.uniforms[name] for each in slots] for name in first.uniforms})
        self._bind_images([each.targets[k] for k in range(len(first.targets)) for each in slots])
        sizes = [each.targets[0].size for each in works]
        program.run(
            -(-max(width for width, _ in sizes) // GROUP), -(-max(height for _, height in sizes) // GROUP), len(works)
        )
        self._ctx.memory_barrier()

    def _bind_images(self, textures: Sequence[Any]) -> None:
        if self._bind is not None:
            names = (ctypes.c_uint * len(textures))(*[each.glo for each in textures])
            self._bind(0, len(textures), ctypes.addressof(names))
            return
        for unit, texture in enumerate(textures):
            texture.bind_to_image(unit, read=False, write=True, format=RGB10_A2 if texture.extra == RGB10_A2 else 0)


def _taken_with(first: Dispatch, collected: Sequence[list[Work]]) -> list[Dispatch]:
    """Take the dispatches of other eyes that one can serve together with the first, and itself, from their lists."""
    works: list[Dispatch] = []
    for of_eye in collected:
        head = of_eye[0] if of_eye else None
        if isinstance(head, Dispatch) and head.is_like(first) and len(works) < first.eyes:
            works.append(head)
            del of_eye[0]
    return works


def _flat(name: str, slots: Sequence[Dispatch]) -> list[Any]:
    """Return the textures of a sampler for all eyes, one eye's after the other."""
    given = [each.textures[name] for each in slots]
    return [texture for each in given for texture in each] if isinstance(given[0], list) else given
