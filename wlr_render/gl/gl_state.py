"""Save and restore the state of an adopted OpenGL context around draws.

What no block of this library touches or depends on is left out: bindings of uniform, storage and transform buffers, of
textures other than 2D, texture units past the first twelve and image units past the third; and of a row of viewports
and scissor boxes only the first is put back.
"""

import contextlib
import ctypes
import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from wlr_render.gl.host_checks import HostChecks
from wlr_render.gl.native_contexts import CurrentContext

UNITS = 12
"""Texture units that are kept; a block must use no others."""

IMAGES = 3
"""Image units that are kept; a block must use no others."""

_DRAW_BUFFERS = 8  # every OpenGL has as many
_UINT, _INT, _BYTE = ctypes.c_uint, ctypes.c_int, ctypes.c_ubyte
_FLOAT, _DOUBLE = ctypes.c_float, ctypes.c_double
_GETTER = {_INT: "glGetIntegerv", _FLOAT: "glGetFloatv", _DOUBLE: "glGetDoublev", _BYTE: "glGetBooleanv"}
_INDEXED_GETTER = {_INT: "glGetIntegeri_v", _BYTE: "glGetBooleani_v"}
_TEXTURE0, _TEXTURE_2D = 0x84C0, 0x0DE1
_SLOT_BYTES = 8 * 8
"""Room for what one getter writes; some drivers write two polygon modes."""
_PLANS = 16
"""States of a host that are remembered: a frame loop has a few."""

_Call = Callable[[], object]


@dataclass(frozen=True)
class _Value:
    """A state value with a getter and a setter.

    Attributes:
        setter: OpenGL function that takes `first`, then the values read.
        read: enums of the parts, in the setter's order.
        size: numbers in each part.
        kind: C type of the numbers.
        first: the setter's fixed arguments.
        neutral: the values that our drawing needs; None if it does not matter or every drawing sets it.
        count: how many draw buffers or units have one each, 0 if it exists once; the setter takes the index first.
        changed: whether our drawing changes it; other values are restored only if they were not neutral.
    """

    setter: str
    read: tuple[int, ...]
    size: int = 1
    kind: Any = _INT
    first: tuple[int, ...] = ()
    neutral: tuple[float, ...] | None = None
    count: int = 0
    changed: bool = False


# (enum, number of them: 0 for a switch that exists once). All are off while we draw, except those in _ON.
# Our drawing switches on nothing else, and `GlContext.drawing` switches it off again.
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
    "DEPTH_CLAMP": (0x864F, 0),
    "DITHER": (0x0BD0, 0),
    "MULTISAMPLE": (0x809D, 0),
    "COLOR_LOGIC_OP": (0x0BF2, 0),
    "POLYGON_OFFSET_FILL": (0x8037, 0),
    "POLYGON_SMOOTH": (0x0B41, 0),
    "SAMPLE_ALPHA_TO_COVERAGE": (0x809E, 0),
    "SAMPLE_ALPHA_TO_ONE": (0x809F, 0),
    "SAMPLE_COVERAGE": (0x80A0, 0),
    "SAMPLE_MASK": (0x8E51, 0),
    "SAMPLE_SHADING": (0x8C36, 0),
    **{f"CLIP_DISTANCE{k}": (0x3000 + k, 0) for k in range(8)},
}
_SWITCHES_OF_OTHERS = {
    "TEXTURE_CUBE_MAP_SEAMLESS": (0x884F, 0),
    "POLYGON_OFFSET_LINE": (0x2A02, 0),
    "POLYGON_OFFSET_POINT": (0x2A01, 0),
    "LINE_SMOOTH": (0x0B20, 0),
}
_ON = {"MULTISAMPLE"}
_OF_A_CLEAN_HOST = {0x0BD0, 0x8F9D}  # DITHER is on by default, and ModernGL switches PRIMITIVE_RESTART on
# What is younger than OpenGL 4.1, by enum: version and extension.
_YOUNGER = {
    0x935C: ((4, 5), "GL_ARB_clip_control"),
    0x8D69: ((4, 3), "GL_ARB_ES3_compatibility"),
    0x8F3A: ((4, 3), ""),  # compute shaders alone write to images
}

_PACK, _UNPACK = (0x0D05, 0x0D02, 0x0D03, 0x0D04, 0x0D00), (0x0CF5, 0x0CF2, 0x0CF3, 0x0CF4, 0x0CF0)
_PIXEL_PARTS = "ALIGNMENT", "ROW_LENGTH", "SKIP_ROWS", "SKIP_PIXELS", "SWAP_BYTES"
_ENUM_NAMES = {0x88EB: "PIXEL_PACK_BUFFER", 0x88EC: "PIXEL_UNPACK_BUFFER", 0x0408: "FRONT_AND_BACK"} | {
    enum: f"{way}_{part}"
    for way, enums in (("PACK", _PACK), ("UNPACK", _UNPACK))
    for enum, part in zip(enums, _PIXEL_PARTS, strict=True)
}
_PIXEL_STORE = (*zip(_PACK, (4, 0, 0, 0, 0), strict=True), *zip(_UNPACK, (4, 0, 0, 0, 0), strict=True))

_VALUES = (
    _Value("glUseProgram", (0x8B8D,), changed=True),
    _Value("glBindVertexArray", (0x85B5,), neutral=(0,), changed=True),
    _Value("glBindBuffer", (0x8894,), first=(0x8892,), changed=True),  # the element buffer's is the vertex array's
    _Value("glBindBuffer", (0x88ED,), first=(0x88EB,), neutral=(0,)),  # pixels packed into a buffer
    _Value("glBindBuffer", (0x88EF,), first=(0x88EC,), neutral=(0,)),  # pixels unpacked from one
    _Value("glBindRenderbuffer", (0x8CA7,), first=(0x8D41,), changed=True),
    _Value("glBindFramebuffer", (0x8CAA,), first=(0x8CA8,), changed=True),  # read
    _Value("glBindFramebuffer", (0x8CA6,), first=(0x8CA9,), changed=True),  # draw
    # Name, level, whether it is layered, layer, access, format.
    _Value("glBindImageTexture", (0x8F3A, 0x8F3B, 0x8F3C, 0x8F3D, 0x8F3E, 0x906E), count=IMAGES, changed=True),
    _Value("glViewport", (0x0BA2,), 4, changed=True),
    _Value("glDepthRange", (0x0B70,), 2, _DOUBLE, neutral=(0.0, 1.0)),
    _Value("glClipControl", (0x935C, 0x935D), neutral=(0x8CA1, 0x935E)),  # lower left, -1 to 1
    _Value("glDepthFunc", (0x0B74,), changed=True),
    _Value("glDepthMask", (0x0B72,), neutral=(1,), changed=True),  # ModernGL clears it for framebuffers without depth
    _Value("glColorMaski", (0x0C23,), 4, _BYTE, neutral=(1, 1, 1, 1), count=_DRAW_BUFFERS),
    _Value("glClearColor", (0x0C22,), 4, _FLOAT, changed=True),
    _Value("glClearDepth", (0x0B73,), 1, _DOUBLE, changed=True),
    _Value("glPolygonMode", (0x0B40,), first=(0x0408,), neutral=(0x1B02,)),  # both faces filled
    *(
        _Value(
            "glPixelStorei", (enum,), first=(enum,), neutral=(usual,), changed=usual == 4
        )  # ModernGL sets alignments
        for enum, usual in _PIXEL_STORE
    ),
)
_VALUES_OF_OTHERS = (
    _Value("glScissor", (0x0C10,), 4),
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


class _Kept:
    """One value of one context, with the numbers that were read last.

    Attributes:
        reads: calls that read the numbers.
        neutral: as `_Value.neutral`.
        changed: as `_Value.changed`.
    """

    def __init__(self, current: CurrentContext, value: _Value, slot: memoryview, index: int = 0) -> None:
        indices = (index,) if value.count else ()
        getter = current.function(
            (_INDEXED_GETTER if value.count else _GETTER)[value.kind], _UINT, *[_UINT] * len(indices), ctypes.c_void_p
        )
        self._numbers = (value.kind * (value.size * len(value.read))).from_buffer(slot)
        address, part_bytes = ctypes.addressof(self._numbers), ctypes.sizeof(value.kind) * value.size
        self.reads: list[_Call] = [
            functools.partial(getter, _UINT(enum), *map(_UINT, indices), ctypes.c_void_p(address + k * part_bytes))
            for k, enum in enumerate(value.read)
        ]
        self._setter(current, value, indices)
        self.neutral, self.changed = value.neutral, value.changed

    def _setter(self, current: CurrentContext, value: _Value, indices: tuple[int, ...]) -> None:
        first = (*indices, *value.first)
        setter = current.function(value.setter, *[_UINT] * len(first), *[value.kind] * len(self._numbers))
        self.set: Callable[..., object] = functools.partial(setter, *first)

    def state(self) -> tuple[float, ...]:
        """Return the numbers that were read."""
        return tuple(self._numbers)

    def is_odd(self) -> bool:
        """Return whether the values differ from the values that our drawing needs."""
        return self.neutral is not None and self.state() != tuple(self.neutral)


class _Switch(_Kept):
    """One switch of one context, or of one of its draw buffers."""

    def _setter(self, current: CurrentContext, value: _Value, indices: tuple[int, ...]) -> None:
        mark, types = "i" * len(indices), [_UINT] * (1 + len(indices))
        turn = [current.function(f"gl{name}{mark}", *types) for name in ("Disable", "Enable")]
        self.set = lambda is_on: turn[bool(is_on)](*value.read, *indices)


class _Program(_Kept):
    """The program in use. One that its owner deleted while it was in use is gone as soon as another one is used."""

    def _setter(self, current: CurrentContext, value: _Value, indices: tuple[int, ...]) -> None:
        use, exists = (
            current.function(value.setter, _UINT),
            current.function("glIsProgram", _UINT, result=ctypes.c_bool),
        )
        self.set = lambda program: use(program if exists(program) else 0)


@dataclass(frozen=True)
class _Plan:
    """Calls for one state of the host: to OpenGL's defaults, back after our own drawing, and after others' drawing."""

    neutralise: Sequence[_Call]
    restore: Sequence[_Call]
    restore_all: Sequence[_Call]


class _Part:
    """Values of one context that are read together.

    Hosts have the same state in most frames: the setter calls are prepared once for each state.
    """

    def __init__(
        self, current: CurrentContext, values: tuple[_Value, ...], switches: dict[str, tuple[int, int]], units: int
    ) -> None:
        asked = [
            *((_Program if value.setter == "glUseProgram" else _Kept, value) for value in values),
            *(
                (
                    _Switch,
                    _Value(
                        "glDisable" if name in _ON else "glEnable", (enum,), 1, _BYTE, (enum,), (name in _ON,), count
                    ),
                )
                for name, (enum, count) in switches.items()
            ),
        ]
        available = [
            (kind, value, index)
            for kind, value in asked
            if value.read[0] not in _YOUNGER or current.has(*_YOUNGER[value.read[0]])
            for index in range(max(value.count, 1))
        ]
        self._memory = bytearray(_SLOT_BYTES * (len(available) + 1 + 2 * units))
        slots = (memoryview(self._memory)[at : at + _SLOT_BYTES] for at in range(0, len(self._memory), _SLOT_BYTES))
        self._kept = [kind(current, value, next(slots), index) for kind, value, index in available]
        enum_names = _ENUM_NAMES | {enum: name for name, (enum, _) in switches.items()}
        self._names = [
            ""
            if value.read[0] in _OF_A_CLEAN_HOST
            else f"{value.setter}({', '.join(f'GL_{enum_names.get(enum, hex(enum))}' for enum in value.first)})"
            for _, value, _ in available
        ]
        self._active = _Kept(current, _ACTIVE_TEXTURE, next(slots))
        self._units = [
            (
                functools.partial(self._active.set, _TEXTURE0 + unit),
                _Kept(current, _TEXTURE, next(slots)),
                _Kept(current, _SAMPLERS[unit], next(slots)),
            )
            for unit in range(units)
        ]
        self._reads: list[_Call] = [read for kept in self._kept for read in kept.reads]
        if units:
            self._reads += self._active.reads
        for activate, texture, sampler in self._units:
            self._reads += [activate, *texture.reads, *sampler.reads]
        self._plans: dict[bytes, _Plan] = {}

    def read(self) -> _Plan:
        """Read the state and return the setter calls."""
        for read in self._reads:
            read()
        state = bytes(self._memory)
        plan = self._plans.get(state)
        if plan is None:
            if len(self._plans) >= _PLANS:
                self._plans.clear()
            plan = self._plans[state] = self._planned()
        return plan

    def odd_values(self) -> list[str]:
        """Return the OpenGL calls with non-default values, except values that our drawing leaves undefined."""
        self.read()
        named = [*zip(self._names, self._kept, strict=True)]
        named += [(f"glBindSampler({unit})", sampler) for unit, (_, _, sampler) in enumerate(self._units)]
        found = (
            name
            for name, kept in named
            if name and kept.is_odd() and (not kept.changed or name.startswith("glDepthMask"))
        )
        return list(dict.fromkeys(found))

    def _planned(self) -> _Plan:
        neutralise: list[_Call] = []
        restore: list[_Call] = []
        restore_all: list[_Call] = []
        for kept in self._kept:
            self._plan_one(kept, neutralise, restore, restore_all)
        for activate, texture, sampler in self._units:
            for calls in (restore, restore_all):
                calls += [activate, functools.partial(texture.set, *texture.state())]
            self._plan_one(sampler, neutralise, restore, restore_all)
        if self._units:
            for calls in (restore, restore_all):
                calls.append(functools.partial(self._active.set, *self._active.state()))
        return _Plan(neutralise, restore, restore_all)

    def _plan_one(self, kept: _Kept, neutralise: list[_Call], restore: list[_Call], restore_all: list[_Call]) -> None:
        state = kept.state()
        set_back = functools.partial(kept.set, *state)
        is_odd = kept.is_odd()
        if is_odd and kept.neutral is not None:
            neutralise.append(functools.partial(kept.set, *kept.neutral))
        if is_odd or kept.changed:
            restore.append(set_back)
        restore_all.append(set_back)


class GlState:
    """Saves and restores the state of one adopted context around drawing blocks.

    Attributes:
        inside: whether such a block is running.
    """

    def __init__(self, current: CurrentContext) -> None:
        """Prepare for the context that is current.

        Raises:
            BadInputError, GlError: as `HostChecks.check`.
        """
        self._checks = HostChecks(current)
        self._part = _Part(current, _VALUES, _SWITCHES, UNITS)
        self._part_of_others = _Part(current, _VALUES_OF_OTHERS, _SWITCHES_OF_OTHERS, 0)
        self.inside, self._others_drew = False, False

    @contextlib.contextmanager
    def kept(self, third_party: bool = False, checked: bool = True) -> Iterator[None]:
        """Return a block that starts from OpenGL's default state and restores the caller's, also after an exception.

        A block within a block is a part of it and costs nothing.

        Args:
            third_party: software that draws in the block, ModernGL's start or pyrender, sets more than we do.
            checked: check first that drawing disturbs nothing; a block that deletes objects only need not.

        Raises:
            BadInputError, GlError: as `HostChecks.check`.
        """
        outer = self.inside
        resume = self._checks.check() if checked and not outer else None
        plans = [*([] if outer else [self._part.read()]), *([self._part_of_others.read()] if third_party else [])]
        self.inside, self._others_drew = True, third_party or (outer and self._others_drew)
        try:
            for plan in plans:
                for call in plan.neutralise:
                    call()
            yield
        except BaseException:
            self._checks.take_error()
            raise
        finally:
            self.inside = outer
            for plan in plans:
                for call in plan.restore_all if self._others_drew else plan.restore:
                    call()
            if resume is not None:
                resume()

    def odd_values(self) -> list[str]:
        """Return the host's OpenGL calls with values other than OpenGL's defaults, e.g. "glEnable(GL_BLEND)"."""
        odd = self._part.odd_values()
        for activate in self._part.read().restore[-1:]:  # reading makes each unit active
            activate()
        return odd

    def is_same_context(self) -> bool:
        """Return whether the current context is the adopted one, and not another one at the same address."""
        return self._checks.is_same_context()

    def release(self) -> None:
        """Delete our objects in the context, which is current."""
        self._checks.release()
