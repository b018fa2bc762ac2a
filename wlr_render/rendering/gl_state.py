"""Save and restore the state of an adopted OpenGL context around draws.

What no block of this library touches or minds is left out: bindings of uniform, storage and transform buffers, of
images, of textures other than 2D, and units past the first eight; and of a row of viewports and scissor boxes only the
first is put back.
"""

import contextlib
import ctypes
import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from wlr_render.rendering.native_contexts import CurrentContext

UNITS = 8
"""Texture units that are kept; a block must use no others."""

_DRAW_BUFFERS = 8  # every OpenGL has as many
_UINT, _INT, _BYTE = ctypes.c_uint, ctypes.c_int, ctypes.c_ubyte
_FLOAT, _DOUBLE = ctypes.c_float, ctypes.c_double
_GETTER = {_INT: "glGetIntegerv", _FLOAT: "glGetFloatv", _DOUBLE: "glGetDoublev"}
_INDEXED_GETTER = {_INT: "glGetIntegeri_v", _BYTE: "glGetBooleani_v"}
_TEXTURE0, _TEXTURE_2D = 0x84C0, 0x0DE1


@dataclass(frozen=True)
class _Value:
    """A state value with a getter and a setter.

    Attributes:
        setter: takes `first`, then what was read.
        read: enums of the parts, in the setter's order.
        size: numbers in each part.
        kind: C type of the numbers.
        first: the setter's fixed arguments.
        neutral: what our own drawing needs; None if it does not matter or every drawing sets it.
        count: how many draw buffers have one each, 0 if it exists once; the setter takes the buffer's index first.
    """

    setter: str
    read: tuple[int, ...]
    size: int = 1
    kind: Any = _INT
    first: tuple[int, ...] = ()
    neutral: tuple[float, ...] | None = None
    count: int = 0


# (enum, number of them: 0 for a switch that exists once). All are off while we draw, but for those of _ON.
_SWITCHES = {
    "BLEND": (0x0BE2, _DRAW_BUFFERS),
    "SCISSOR_TEST": (0x0C11, 0),
    "DEPTH_TEST": (0x0B71, 0),
    "CULL_FACE": (0x0B44, 0),
    "STENCIL_TEST": (0x0B90, 0),
    "FRAMEBUFFER_SRGB": (0x8DB9, 0),
    "RASTERIZER_DISCARD": (0x8C89, 0),
    "PROGRAM_POINT_SIZE": (0x8642, 0),
    "PRIMITIVE_RESTART": (0x8F9D, 0),
    "PRIMITIVE_RESTART_FIXED_INDEX": (0x8D69, 0),
    "TEXTURE_CUBE_MAP_SEAMLESS": (0x884F, 0),
    "DEPTH_CLAMP": (0x864F, 0),
    "DITHER": (0x0BD0, 0),
    "MULTISAMPLE": (0x809D, 0),
    "COLOR_LOGIC_OP": (0x0BF2, 0),
    "POLYGON_OFFSET_FILL": (0x8037, 0),
    "POLYGON_OFFSET_LINE": (0x2A02, 0),
    "POLYGON_OFFSET_POINT": (0x2A01, 0),
    "POLYGON_SMOOTH": (0x0B41, 0),
    "LINE_SMOOTH": (0x0B20, 0),
    "SAMPLE_ALPHA_TO_COVERAGE": (0x809E, 0),
    "SAMPLE_ALPHA_TO_ONE": (0x809F, 0),
    "SAMPLE_COVERAGE": (0x80A0, 0),
    "SAMPLE_MASK": (0x8E51, 0),
    **{f"CLIP_DISTANCE{k}": (0x3000 + k, 0) for k in range(8)},
}
_ON = {"MULTISAMPLE"}

_PACK, _UNPACK = (0x0D05, 0x0D02, 0x0D03, 0x0D04, 0x0D00), (0x0CF5, 0x0CF2, 0x0CF3, 0x0CF4, 0x0CF0)
_PIXEL_STORE = (*zip(_PACK, (4, 0, 0, 0, 0), strict=True), *zip(_UNPACK, (4, 0, 0, 0, 0), strict=True))

_VALUES = (
    _Value("glUseProgram", (0x8B8D,)),
    _Value("glBindVertexArray", (0x85B5,), neutral=(0,)),
    _Value("glBindBuffer", (0x8894,), first=(0x8892,)),  # the element buffer's binding is the vertex array's
    _Value("glBindBuffer", (0x88ED,), first=(0x88EB,), neutral=(0,)),  # pixels packed into a buffer
    _Value("glBindBuffer", (0x88EF,), first=(0x88EC,), neutral=(0,)),  # pixels unpacked from one
    _Value("glBindRenderbuffer", (0x8CA7,), first=(0x8D41,)),
    _Value("glBindFramebuffer", (0x8CAA,), first=(0x8CA8,)),  # read
    _Value("glBindFramebuffer", (0x8CA6,), first=(0x8CA9,)),  # draw
    _Value("glViewport", (0x0BA2,), 4),
    _Value("glScissor", (0x0C10,), 4),
    _Value("glDepthRange", (0x0B70,), 2, _DOUBLE, neutral=(0.0, 1.0)),
    _Value("glClipControl", (0x935C, 0x935D), neutral=(0x8CA1, 0x935E)),  # lower left, -1 to 1
    _Value("glDepthFunc", (0x0B74,), neutral=(0x0203,)),  # <=
    _Value("glDepthMask", (0x0B72,), neutral=(1,)),
    _Value("glColorMaski", (0x0C23,), 4, _BYTE, neutral=(1, 1, 1, 1), count=_DRAW_BUFFERS),
    _Value("glClearColor", (0x0C22,), 4, _FLOAT),
    _Value("glClearDepth", (0x0B73,), 1, _DOUBLE),
    _Value("glPolygonMode", (0x0B40,), first=(0x0408,), neutral=(0x1B02,)),  # both faces filled
    *(_Value("glPixelStorei", (enum,), first=(enum,), neutral=(usual,)) for enum, usual in _PIXEL_STORE),
)
_VALUES_OF_OTHERS = (
    _Value("glBlendFuncSeparatei", (0x80C9, 0x80C8, 0x80CB, 0x80CA), count=_DRAW_BUFFERS),
    _Value("glBlendEquationSeparatei", (0x8009, 0x883D), neutral=(0x8006, 0x8006), count=_DRAW_BUFFERS),  # sums
    _Value("glCullFace", (0x0B45,), neutral=(0x0405,)),  # back
    _Value("glFrontFace", (0x0B46,), neutral=(0x0901,)),  # counter-clockwise
    _Value("glPrimitiveRestartIndex", (0x8F9E,)),
    _Value("glPointSize", (0x0B11,), 1, _FLOAT, neutral=(1.0,)),
    _Value("glLineWidth", (0x0B21,), 1, _FLOAT, neutral=(1.0,)),
)
_ACTIVE_TEXTURE = _Value("glActiveTexture", (0x84E0,))
_TEXTURE = _Value("glBindTexture", (0x8069,), first=(_TEXTURE_2D,))
_SAMPLERS = [_Value("glBindSampler", (0x8919,), first=(unit,), neutral=(0,)) for unit in range(UNITS)]


class _Part(Protocol):
    def read(self) -> Any: ...
    def neutralise(self, state: Any) -> None: ...
    def write(self, state: Any) -> None: ...


class _Kept:
    """One value of one context."""

    def __init__(self, current: CurrentContext, value: _Value, index: int = 0) -> None:
        indices = (index,) if value.count else ()
        getter = current.function(
            (_INDEXED_GETTER if value.count else _GETTER)[value.kind], _UINT, *[_UINT] * len(indices), ctypes.c_void_p
        )
        self._size = value.size * len(value.read)
        self._numbers = (value.kind * (self._size + 4))()  # some drivers write two polygon modes
        address, part_bytes = ctypes.addressof(self._numbers), ctypes.sizeof(value.kind) * value.size
        self._read = [
            functools.partial(getter, _UINT(enum), *indices, ctypes.c_void_p(address + k * part_bytes))
            for k, enum in enumerate(value.read)
        ]
        first = (*indices, *value.first)
        setter = current.function(value.setter, *[_UINT] * len(first), *[value.kind] * self._size)
        self._set = functools.partial(setter, *first)
        self._neutral = None if value.neutral is None else list(value.neutral)

    def read(self) -> list[float]:
        for read in self._read:
            read()
        numbers: list[float] = self._numbers[: self._size]
        return numbers

    def neutralise(self, state: list[float]) -> None:
        if self._neutral is not None and state != self._neutral:
            self._set(*self._neutral)

    def write(self, state: list[float]) -> None:
        self._set(*state)


class _Switch:
    """One switch of one context, or of one of its draw buffers or viewports."""

    def __init__(self, current: CurrentContext, enum: int, neutral: bool, index: int | None) -> None:
        indices = () if index is None else (index,)
        mark, types = "i" * len(indices), [_UINT] * (1 + len(indices))
        self._is_on = functools.partial(current.function(f"glIsEnabled{mark}", *types, result=_BYTE), enum, *indices)
        self._turn = tuple(
            functools.partial(current.function(f"gl{turn}{mark}", *types), enum, *indices)
            for turn in ("Disable", "Enable")
        )
        self._neutral = neutral

    def read(self) -> bool:
        return bool(self._is_on())

    def neutralise(self, state: bool) -> None:
        if state != self._neutral:
            self._turn[self._neutral]()

    def write(self, state: bool) -> None:
        self._turn[state]()


class _Units:
    """The active texture unit, and what is bound to each of the kept ones."""

    def __init__(self, current: CurrentContext) -> None:
        self._active, self._texture = _Kept(current, _ACTIVE_TEXTURE), _Kept(current, _TEXTURE)
        self._samplers = [_Kept(current, sampler) for sampler in _SAMPLERS]

    def _each(self) -> Iterator[_Kept]:
        """Make each unit active in turn and yield its sampler."""
        for unit, sampler in enumerate(self._samplers):
            self._active.write([_TEXTURE0 + unit])
            yield sampler

    def read(self) -> list[list[float]]:
        active = self._active.read()
        return [active, *(numbers for sampler in self._each() for numbers in (self._texture.read(), sampler.read()))]

    def neutralise(self, state: list[list[float]]) -> None:
        for sampler, found in zip(self._samplers, state[2::2], strict=True):
            sampler.neutralise(found)

    def write(self, state: list[list[float]]) -> None:
        active, *bound = state
        for sampler, texture, of_sampler in zip(self._each(), bound[::2], bound[1::2], strict=True):
            self._texture.write(texture)
            sampler.write(of_sampler)
        self._active.write(active)


def _kept_values(current: CurrentContext, table: tuple[_Value, ...]) -> list[_Kept]:
    return [
        _Kept(current, value, index)
        for value in table
        if current.load_opengl_function(value.setter)  # glClipControl is younger than OpenGL 4.3
        for index in range(max(value.count, 1))
    ]


class GlState:
    """Saves and restores the state of one adopted context around drawing blocks.

    Attributes:
        inside: whether such a block is running.
    """

    def __init__(self, current: CurrentContext) -> None:
        values, self._parts_of_others = (_kept_values(current, table) for table in (_VALUES, _VALUES_OF_OTHERS))
        switches = [
            _Switch(current, enum, name in _ON, index if count else None)
            for name, (enum, count) in _SWITCHES.items()
            for index in range(max(count, 1))
        ]
        self._parts: tuple[_Part, ...] = (*values, *switches, _Units(current))
        self._error = current.function("glGetError", result=_UINT)
        self.inside = False

    @contextlib.contextmanager
    def kept(self, third_party: bool = False) -> Iterator[None]:
        """Return a block that starts from OpenGL's default state and restores the caller's, also after an exception.

        Errors that OpenGL holds are dropped. A block within a block is a part of it and costs nothing.

        Args:
            third_party: software that draws in the block, ModernGL's start or pyrender, sets more than we do.
        """
        outer = self.inside
        parts: list[_Part] = [*([] if outer else self._parts), *(self._parts_of_others if third_party else [])]
        found = [part.read() for part in parts]
        self.inside = True
        try:
            for part, state in zip(parts, found, strict=True):
                part.neutralise(state)
            yield
        finally:
            self.inside = outer
            for part, state in zip(parts, found, strict=True):
                part.write(state)
            while self._error():
                pass
