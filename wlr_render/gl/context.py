"""An OpenGL context, our own or an adopted one: drawing blocks, shader programs, textures and framebuffers."""

import contextlib
import ctypes
import threading
import weakref
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, TypeVar

import moderngl
import numpy as np
from numpy.typing import DTypeLike, NDArray

from wlr_render.errors import BadInputError
from wlr_render.gl.dispatches import GROUP, Dispatches
from wlr_render.gl.gl_errors import ErrorReader, GlError, error_name
from wlr_render.gl.native_contexts import CurrentContext
from wlr_render.gl.ownership import ContextOwner, free_dropped
from wlr_render.gl.programs import (
    MULTI_BIND_VERSION,
    UNITS,
    TextureUnits,
    for_eyes,
    forget_textures,
    pass_source,
    shader_source,
)

Texture = moderngl.Texture
TextureArray = moderngl.TextureArray
Context = moderngl.Context
Framebuffer = moderngl.Framebuffer
Program = moderngl.Program
ComputeShader = moderngl.ComputeShader
VertexArray = moderngl.VertexArray
Sampler = moderngl.Sampler
Buffer = moderngl.Buffer

_Object = TypeVar("_Object")

_SOFTWARE = "llvmpipe", "softpipe", "swrast", "swiftshader"
_FRAMEBUFFER = 0x8D40
_SRGB8 = 0x8C41  # GL_SRGB8: texels are decoded to linear light before they are filtered
SRGB8_ALPHA8 = 0x8C43
_RGB10_A2 = 0x8059
_SRGB_DECODE, _SKIP_DECODE = 0x8A48, 0x8A4A  # enums of GL_EXT_texture_sRGB_decode, which some OpenGL ES drivers lack


class _NestedBlock:
    """A block nested in a drawing block."""

    def __init__(self, ctx: moderngl.Context, at_end: Callable[[], None]) -> None:
        self._ctx, self._at_end = ctx, at_end

    def __enter__(self) -> moderngl.Context:
        return self._ctx

    def __exit__(self, *exception: object) -> None:
        self._at_end()


class GlContext:
    """An OpenGL context and its shader programs; a context manager that releases it.

    Each `drawing` block makes its context current, and the previous context at the end.

    Attributes:
        backend: "egl", "osmesa", or the platform of an adopted context.
        renderer: OpenGL's name of the renderer, e.g. "llvmpipe (LLVM 15.0.6, 256 bits)".
        largest_side_px: limit of OpenGL on a texture's or framebuffer's width and height.
        host_is_clean: whether this is the host's own context, in which it guarantees OpenGL's default state.
        computes: whether the warp and its passes run as compute shaders: on a GPU with OpenGL 4.4.
        dispatches: runs these shaders.
    """

    def __init__(
        self,
        ctx: moderngl.Context,
        current: CurrentContext,
        owner: ContextOwner,
        caller: moderngl.Context | None = None,
        host_is_clean: bool = False,
    ) -> None:
        """Wrap ModernGL's context `ctx` of the current context; `caller` is the host's ModernGL context."""
        self._ctx, self._current, self._owner, self._caller = ctx, current, owner, caller
        self._objects: weakref.WeakSet[Any] = weakref.WeakSet()
        # Garbage-collected objects are freed in the next drawing block, in which this context is certainly current.
        self._ctx.gc_mode = "context_gc"
        # ModernGL's own choice, the last unit of a fragment shader, may be one of a compute shader's for two eyes.
        self._ctx.default_texture_unit = UNITS - 1
        self._programs: dict[tuple[object, ...], Program] = {}
        self._compute_programs: dict[tuple[object, ...], ComputeShader] = {}
        self._errors = ErrorReader(current)
        self.host_is_clean = host_is_clean
        self._depth, self._thread, self._switched, self._is_disturbed = 0, 0, False, True
        self._nested = _NestedBlock(ctx, self._switch_off)
        self._made_objects = False  # a clean host's errors are read only in blocks that make objects
        self._bind = current.function("glBindFramebuffer", *[ctypes.c_uint] * 2)
        self._set_viewport = current.function("glViewport", *[ctypes.c_int] * 4)
        self._no_vertices: dict[int, VertexArray] = {}
        self._released = False
        self.backend = current.platform
        with owner.entered():
            self.renderer = str(ctx.info["GL_RENDERER"])
            self.largest_side_px = int(ctx.info["GL_MAX_TEXTURE_SIZE"])
            ctx.extra = TextureUnits(ctx, current)
            self.dispatches = Dispatches(ctx, current, self.is_software)
        self.computes = ctx.version_code >= MULTI_BIND_VERSION and not self.is_software

    def __enter__(self) -> "GlContext":
        return self

    def __exit__(self, *exception: object) -> None:
        self.release()

    @property
    def is_software(self) -> bool:
        """True for a software renderer: work per pixel is expensive, and texture filters have exact weights."""
        return any(name in self.renderer.lower() for name in _SOFTWARE)

    def drawing(self, third_party: bool = False) -> contextlib.AbstractContextManager[moderngl.Context]:
        """Return a block of OpenGL calls: this context is current, capabilities are off, errors are raised at its end.

        Args:
            third_party: True if other software draws in the block, which may leave capabilities on.

        Raises:
            GlError: a call in the block failed.
            BadInputError: the context has been released, or cannot be made current on this thread.
        """
        return self._nested if self._is_inside() and not third_party else self._block(third_party, True)

    def working(self) -> contextlib.AbstractContextManager[moderngl.Context]:
        """Return a block like `drawing`, in which this library alone draws, and leaves all capabilities off."""
        return self._nested if self._is_inside() else self._block(False, False)

    def _is_inside(self) -> bool:
        return self._depth > 0 and self._thread == threading.get_ident()

    @contextlib.contextmanager
    def _block(self, third_party: bool, is_public: bool) -> Iterator[moderngl.Context]:
        self._check_alive()
        with self._owner.entered():
            self._check_alive()  # another thread may have released the context meanwhile
            outermost = not self._depth
            if outermost and self._is_disturbed and not self.host_is_clean:
                self._ctx.enable_only(moderngl.NOTHING)
            free_dropped(self._ctx)
            self._depth, self._thread = self._depth + 1, threading.get_ident()
            self._switched = self._switched or third_party
            self._is_disturbed = is_public  # other software may leave any capability on
            try:
                yield self._ctx
            except BaseException:
                self.take_error()
                raise
            finally:
                self._depth -= 1
                self._switch_off()
                if outermost or third_party:
                    forget_textures(self._ctx)
            if outermost and (self._made_objects or not self.host_is_clean):
                self._made_objects = False
                error = self.take_error()
                if error:
                    pending = "; or the host had it pending before" if self.host_is_clean else ""
                    raise GlError(f"OpenGL reports {error_name(error)} ({self.renderer}){pending}.")

    def _check_alive(self) -> None:
        if self._released:
            raise BadInputError("the OpenGL context has been released with all its pictures; read them before release.")

    def _switch_off(self) -> None:
        if self._switched:
            self._ctx.enable_only(moderngl.NOTHING)
            self._ctx.depth_func = "<"
            self._switched = False

    @contextlib.contextmanager
    def host(self) -> Iterator[None]:
        """Return a block, in a drawing block, for the framebuffers of the program whose context was adopted.

        Framebuffers are not shared between contexts. Bindings are restored at the end; see `ContextOwner.host`.

        Raises:
            BadInputError: the adopted context was not current on this thread before the drawing block.
        """
        depth = self._depth
        with self._owner.host():
            self._depth = 0  # a nested block must make this context current again
            try:
                yield
            finally:
                self._depth = depth

    def function(self, name: str, *argument_types: Any, result: Any = None) -> Callable[..., Any]:
        """Look up an OpenGL function that ModernGL hides, with `ctypes` types; call it in a drawing block."""
        return self._current.function(name, *argument_types, result=result)

    def has(self, thing: Texture | TextureArray | Framebuffer | Buffer) -> bool:
        """Return whether the object was made in this context or in the adopted context."""
        if thing.ctx is self._ctx or thing.ctx is self._caller:
            return True
        return not isinstance(thing.ctx.mglo, moderngl.InvalidObject) and self._owner.is_same_as(thing.ctx)

    def is_ours(self, thing: Framebuffer) -> bool:
        """Return whether the object was made in this context, not in the adopted one."""
        return bool(thing.ctx is self._ctx)

    @property
    def has_host(self) -> bool:
        """True if another program's context shares textures with this one."""
        return self._owner.has_host

    def take_error(self) -> int:
        """Return OpenGL's oldest error (0: none) and clear all errors; call it in a drawing block.

        Raises:
            GlError: the context is lost.
        """
        return self._errors.take()

    def program(self, vertex: str, fragment: str, /, **constants: float) -> Program:
        """Return the program of two files in shaders/, compiled once for each set of constants (`#define NAME value`).

        Args:
            vertex: file name.
            fragment: file name.
            constants: constants of both.
        """
        key = vertex, fragment, *sorted(constants.items())
        if key not in self._programs:
            program = self._ctx.program(
                vertex_shader=shader_source(vertex, constants),
                fragment_shader=shader_source(fragment, constants),
            )
            self._programs[key] = self.tracked(program)
        return self._programs[key]

    def compute_program(self, name: str, /, **constants: float) -> ComputeShader:
        """Return the compute shader of a file in shaders/, compiled once for each set of constants; OpenGL 4.4.

        Args:
            name: file name of a compute shader, or of a full-screen fragment shader without derivatives.
            constants: see `program`.
        """
        eyes = self.dispatches.eyes
        key = eyes, name, *sorted(constants.items())
        if key not in self._compute_programs:
            is_pass = name.endswith(".frag")
            text = pass_source(name, GROUP, constants) if is_pass else shader_source(name, constants | {"GROUP": GROUP})
            self._compute_programs[key] = self.tracked(self._ctx.compute_shader(for_eyes(text, eyes)))
        return self._compute_programs[key]

    def full_screen(self, fragment: str, /, **constants: float) -> VertexArray:
        """Return a triangle that runs a fragment shader for each pixel of a target: `.render(vertices=3)`."""
        return self.no_vertices(self.program("full_screen.vert", fragment, **constants))

    def no_vertices(self, program: Program) -> VertexArray:
        """Return a program that draws from `gl_VertexID` alone: `.render(vertices=n)`; cached for each program."""
        if program.glo not in self._no_vertices:
            self._no_vertices[program.glo] = self.tracked(self._ctx.vertex_array(program, []))
        return self._no_vertices[program.glo]

    def target(self, size: tuple[int, int], components: int, dtype: str) -> Texture:
        """Return an empty texture of (width, height) to draw into: dtype "f1" (8 bit), "nu2", "f2", "f4", "i4" or "u1".

        "srgb" of four components holds sRGB codes in 8 bits: drawn and read unchanged, decoded when sampled. "rgb10"
        has 10 bits, and 2 of alpha, and is read as uint16.
        """
        if dtype == "srgb":
            texture = self.tracked(self._ctx.texture(size, components, internal_format=SRGB8_ALPHA8))
            texture.extra = SRGB8_ALPHA8
        elif dtype == "rgb10":
            texture = self.tracked(self._ctx.texture(size, components, dtype="nu2", internal_format=_RGB10_A2))
        else:
            texture = self.tracked(self._ctx.texture(size, components, dtype=dtype))
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.repeat_x = texture.repeat_y = False
        return texture

    @cached_property
    def no_status(self) -> Texture:
        """A placeholder for programs that draw no backdrop; its first use must be in a drawing block."""
        return self.target((1, 1), 1, "u1")

    def srgb_texture(self, image: NDArray[np.uint8]) -> Texture:
        """Return an sRGB picture (height, width, 3) that is sampled in linear light, bilinear, repeating.

        The hardware's filter weights have 8 bits, so the error of a sample is up to 6e-3 of the local contrast.
        """
        height, width = image.shape[:2]
        pixels = np.ascontiguousarray(image)
        texture = self.tracked(self._ctx.texture((width, height), 3, pixels, alignment=1, internal_format=_SRGB8))
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = True
        return texture

    def plain_sampler(self, decodes: bool = False) -> Sampler:
        """Return a nearest-texel sampler without depth comparison; it reads sRGB formats as codes unless `decodes`."""
        nearest = moderngl.NEAREST, moderngl.NEAREST
        sampler = self.tracked(self._ctx.sampler(repeat_x=False, repeat_y=False, filter=nearest, compare_func=""))
        if not decodes and self.reads_srgb_codes:
            number = vars(sampler)["_glo"]
            self.function("glSamplerParameteri", *[ctypes.c_uint] * 3)(number, _SRGB_DECODE, _SKIP_DECODE)
        return sampler

    def third_party_texture(self, number: int, size: tuple[int, int]) -> Texture:
        """Wrap an 8-bit 2D texture that other software owns, by its OpenGL name; call it in a third-party block."""
        forget_textures(self._ctx)
        return self._ctx.external_texture(number, size, 4, 0, "f1")

    @property
    def texture_unit(self) -> int:
        """The unit for textures that are bound for writing or queries; no shader reads from it."""
        return int(self._ctx.default_texture_unit)

    @property
    def reads_srgb_codes(self) -> bool:
        """True if `plain_sampler` can read the codes of sRGB formats; otherwise OpenGL always decodes them."""
        return "GL_EXT_texture_sRGB_decode" in self._ctx.extensions

    def depth_target(self, size: tuple[int, int]) -> Texture:
        """Return an empty depth texture of (width, height), 24 bits, read as plain values."""
        texture = self.tracked(self._ctx.depth_texture(size))
        texture.compare_func = ""
        return texture

    def framebuffer(self, textures: list[Texture], depth: Texture | None = None) -> Framebuffer:
        """Return a target of several textures of one size, the shader's outputs 0, 1, ... in this order."""
        made = self.tracked(self._ctx.framebuffer(textures, depth))
        made.use()  # sets the draw buffers
        return made

    def draw_to(self, framebuffer: Framebuffer) -> None:
        """Draw to a framebuffer's viewport until another one is bound.

        `Framebuffer.use` also sets draw buffers, masks and scissor test, in five more calls: our framebuffers keep
        these settings from their first use. ModernGL does not record this binding: do not create or clear framebuffers
        before the draw.
        """
        if not framebuffer.glo:
            framebuffer.use()
            return
        self._bind(_FRAMEBUFFER, framebuffer.glo)
        self._set_viewport(*framebuffer.viewport)

    def triangles(
        self, program: Program, attributes: dict[str, NDArray[Any]], indices: NDArray[np.uint32]
    ) -> VertexArray:
        """Return an indexed triangle mesh; attributes (vertices, n) become float32, unused attributes are left out."""
        content = [
            (self._buffer(values, np.float32), f"{values.shape[1]}f4", name)
            for name, values in attributes.items()
            if name in program
        ]
        return self.tracked(self._ctx.vertex_array(program, content, self._buffer(indices, np.uint32)))

    def depth_test(self) -> None:
        """Enable the depth test (less or equal) until the end of the innermost `drawing` block."""
        self._switched = True
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        self._ctx.depth_func = "<="

    def release(self) -> bool:
        """Destroy the context with its objects; of a clean host's context only the objects made here.

        Returns:
            Whether it was released: False, with a RuntimeWarning, if a clean host's context is not current on this
            thread.
        """
        caller_is_gone = self._caller is not None and isinstance(self._caller.mglo, moderngl.InvalidObject)
        is_gone = self.host_is_clean and caller_is_gone and not self._current.is_current()
        if not self._released and (is_gone or self._freed()):
            self._released = True
            self._programs.clear()
            self._compute_programs.clear()
            self._no_vertices.clear()
        return self._released

    def _freed(self) -> bool:
        try:
            return self._owner.release(self._objects)
        except GlError:
            return True  # a lost context has lost all its objects

    def _buffer(self, values: NDArray[Any], dtype: DTypeLike) -> Any:
        return self.tracked(self._ctx.buffer(np.ascontiguousarray(values, dtype)))

    def tracked(self, made: _Object) -> _Object:
        """Return an object of this context with a method `release`, which is called when the context is released."""
        self._objects.add(made)
        self._made_objects = True
        return made
