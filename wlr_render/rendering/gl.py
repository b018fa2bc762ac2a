"""OpenGL contexts: opening one without a display or adopting one, loading shaders, checking for errors.

Every image on the GPU lies with its top row first, as in numpy, because the projection in `shaders/conventions.glsl`
is turned over; so reading and writing textures here turns nothing.
"""

import contextlib
import ctypes
import os
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, TypeVar

import moderngl
import numpy as np
from numpy.typing import DTypeLike, NDArray

from wlr_render import files
from wlr_render.errors import BadInputError, MissingGlError
from wlr_render.rendering.context_ownership import AdoptedContext, ContextOwner, OwnContext
from wlr_render.rendering.gl_state import UNITS, GlState
from wlr_render.rendering.native_contexts import CurrentContext, EglBinding, NoCurrentContextError, OsMesaContext

Texture = moderngl.Texture
Context = moderngl.Context
Framebuffer = moderngl.Framebuffer
Program = moderngl.Program
VertexArray = moderngl.VertexArray
Sampler = moderngl.Sampler

_Object = TypeVar("_Object")

_SOFTWARE = "llvmpipe", "softpipe", "swrast", "swiftshader"
_VERSION = 4, 3
_VERSION_CODE = 430
_SRGB8 = 0x8C41  # GL_SRGB8: texels are decoded to linear light before they are filtered
_SRGB_DECODE, _SKIP_DECODE = 0x8A48, 0x8A4A  # of GL_EXT_texture_sRGB_decode, which every desktop driver has


class GlError(RuntimeError):
    """OpenGL refused a call: a fault of this library or of the driver, not of the input."""


class GlContext:
    """An OpenGL context and its shader programs; a context manager that releases it.

    Several may live in one process: each `drawing` block makes its own current, and afterwards the previous one. An
    adopted one is made current by the program that it belongs to, which gets it back from each block as it was.

    Attributes:
        backend: "egl", "osmesa", or an adopted context's platform.
        renderer: name of what draws, e.g. "llvmpipe (LLVM 15.0.6, 256 bits)".
        largest_side_px: limit of OpenGL on a texture's or framebuffer's width and height.
    """

    def __init__(
        self,
        ctx: moderngl.Context,
        current: CurrentContext,
        owner: ContextOwner,
        caller: moderngl.Context | None = None,
    ) -> None:
        """Wrap ModernGL's context of the current one; `caller` is another of ModernGL's for the same."""
        self._ctx, self._current, self._owner, self._caller = ctx, current, owner, caller
        self._objects: weakref.WeakSet[Any] = weakref.WeakSet()
        # Objects that Python drops are freed in the next drawing block, when this context is sure to be current.
        self._ctx.gc_mode = "context_gc"
        self._programs: dict[tuple[object, ...], Program] = {}
        self._released = False
        self.backend = current.platform
        with owner.entered(third_party=False):
            self.renderer = str(ctx.info["GL_RENDERER"])
            self.largest_side_px = int(ctx.info["GL_MAX_TEXTURE_SIZE"])
        for path in files.resource("shaders").glob("*.glsl"):
            self._ctx.includes[path.name] = path.read_text(encoding="utf-8")

    def __enter__(self) -> "GlContext":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    @property
    def is_software(self) -> bool:
        """Whether it is a software renderer: work per pixel is expensive, and texture filters have exact weights."""
        return any(name in self.renderer.lower() for name in _SOFTWARE)

    @contextlib.contextmanager
    def drawing(self, third_party: bool = False) -> Iterator[moderngl.Context]:
        """A block of OpenGL calls: this context current, all switches off, errors raised at the end.

        Other users of OpenGL in the process leave their context current and blending on, and ModernGL would then
        draw silently wrong pixels.

        Args:
            third_party: other software draws in the block, so that more of an adopted context's state has to be kept.

        Raises:
            GlError: a call in the block failed.
            BadInputError: it has been released, or an adopted context is not current.
        """
        if self._released:
            raise BadInputError("the OpenGL context has been released with all its pictures; read them before release.")
        with self._owner.entered(third_party):
            _free_dropped(self._ctx)
            self._ctx.enable_only(moderngl.NOTHING)
            self._ctx.clear_errors()
            yield self._ctx
            error = self._ctx.error
            if error != "GL_NO_ERROR":
                raise GlError(f"OpenGL reports {error} ({self.renderer}).")

    def function(self, name: str, *argument_types: Any, result: Any = None) -> Callable[..., Any]:
        """Look up an OpenGL function that ModernGL hides, with `ctypes` types; call it in a drawing block."""
        return self._current.function(name, *argument_types, result=result)

    def has(self, thing: Texture | Framebuffer) -> bool:
        """Whether the object was made in this context, by this library or by the adopted ModernGL context."""
        return thing.ctx is self._ctx or thing.ctx is self._caller

    def program(self, vertex: str, fragment: str, functions: str = "", /, **constants: float) -> Program:
        """The program of two files in shaders/, compiled once for each set of constants (`#define NAME value`).

        Args:
            vertex: file name.
            fragment: file name.
            functions: generated GLSL that the fragment shader calls; it stands before the file's own text.
            constants: for both.
        """
        key = vertex, fragment, functions, *sorted(constants.items())
        if key not in self._programs:
            program = self._ctx.program(
                vertex_shader=_source(vertex, constants), fragment_shader=_source(fragment, constants, functions)
            )
            self._programs[key] = self._tracked(program)
        return self._programs[key]

    def full_screen(
        self, fragment: str, vertex: str = "full_screen.vert", functions: str = "", /, **constants: float
    ) -> VertexArray:
        """One triangle over the whole target that runs a fragment shader for each pixel: `.render(vertices=3)`."""
        return self._tracked(self._ctx.vertex_array(self.program(vertex, fragment, functions, **constants), []))

    def target(self, size: tuple[int, int], components: int, dtype: str) -> Texture:
        """An empty texture of (width, height) to draw into: dtype "f1" (8 bit), "f2", "f4", "i4" or "u1"."""
        texture = self._tracked(self._ctx.texture(size, components, dtype=dtype))
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.repeat_x = texture.repeat_y = False
        return texture

    def srgb_texture(self, image: NDArray[np.uint8]) -> Texture:
        """An sRGB picture (height, width, 3) that is sampled in linear light, bilinear, repeating.

        The hardware's filter weights have 8 bits, so that a sample errs by up to 6e-3 of the local contrast.
        """
        height, width = image.shape[:2]
        pixels = np.ascontiguousarray(image)
        texture = self._tracked(self._ctx.texture((width, height), 3, pixels, alignment=1, internal_format=_SRGB8))
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        texture.repeat_x = texture.repeat_y = True
        return texture

    def plain_sampler(self) -> Sampler:
        """A sampler that reads the nearest texel, without sRGB decoding or depth comparison."""
        nearest = moderngl.NEAREST, moderngl.NEAREST
        sampler = self._tracked(self._ctx.sampler(repeat_x=False, repeat_y=False, filter=nearest, compare_func=""))
        if "GL_EXT_texture_sRGB_decode" in self._ctx.extensions:
            number = vars(sampler)["_glo"]
            self.function("glSamplerParameteri", *[ctypes.c_uint] * 3)(number, _SRGB_DECODE, _SKIP_DECODE)
        return sampler

    def depth_target(self, size: tuple[int, int]) -> Texture:
        """An empty depth texture of (width, height), 24 bits, read as plain values."""
        texture = self._tracked(self._ctx.depth_texture(size))
        texture.compare_func = ""
        return texture

    def framebuffer(self, textures: list[Texture], depth: Texture | None = None) -> Framebuffer:
        """A target of several textures of one size, the shader's outputs 0, 1, ... in this order."""
        return self._tracked(self._ctx.framebuffer(textures, depth))

    def triangles(
        self, program: Program, attributes: dict[str, NDArray[Any]], indices: NDArray[np.uint32]
    ) -> VertexArray:
        """An indexed triangle mesh; attributes (vertices, n) become float32, unused ones are left out."""
        content = [
            (self._buffer(values, np.float32), f"{values.shape[1]}f4", name)
            for name, values in attributes.items()
            if name in program
        ]
        return self._tracked(self._ctx.vertex_array(program, content, self._buffer(indices, np.uint32)))

    def depth_test(self) -> None:
        """Enable the depth test (less or equal) until the end of the `drawing` block."""
        self._ctx.enable_only(moderngl.DEPTH_TEST)
        self._ctx.depth_func = "<="

    def release(self) -> None:
        """Destroy an own context with its objects; in an adopted one, only the objects made here."""
        self._programs.clear()
        self._released = True
        self._owner.release(list(self._objects))

    def _buffer(self, values: NDArray[Any], dtype: DTypeLike) -> Any:
        return self._tracked(self._ctx.buffer(np.ascontiguousarray(values, dtype)))

    def _tracked(self, made: _Object) -> _Object:
        self._objects.add(made)
        return made


@dataclass(frozen=True, eq=False)
class RenderTarget:
    """A framebuffer and its textures, in the order of the shader's outputs."""

    framebuffer: Framebuffer
    textures: tuple[Texture, ...]


class RenderTargets:
    """Targets by name; a target is made once for each size, and the next drawing overwrites it."""

    def __init__(self, context: GlContext) -> None:
        self._context = context
        self._targets: dict[str, RenderTarget] = {}

    def get(
        self, name: str, size: tuple[int, int], *formats: tuple[int, str], with_depth: bool = False
    ) -> RenderTarget:
        """The target of a name and size (width, height).

        Args:
            name: of the target, which keeps its formats.
            size: (width, height) in pixels.
            formats: components and dtype of each texture, as in `GlContext.target`.
            with_depth: attach a depth texture.
        """
        target = self._targets.get(name)
        if target is None or target.framebuffer.size != size:
            textures = [self._context.target(size, *each) for each in formats]
            depth = self._context.depth_target(size) if with_depth else None
            target = self._targets[name] = RenderTarget(self._context.framebuffer(textures, depth), tuple(textures))
        return target


def _free_dropped(ctx: moderngl.Context) -> None:
    """Like `Context.gc`, but skips objects that were already released."""
    while ctx.objects:
        dropped = ctx.objects.popleft()
        if not isinstance(dropped, moderngl.InvalidObject):
            dropped.release()


def _source(name: str, constants: dict[str, float], functions: str = "") -> str:
    version, text = files.resource("shaders", name).read_text(encoding="utf-8").split("\n", 1)
    defines = (f"#define {key} {value}" for key, value in constants.items())
    return "\n".join([version, *defines, functions, "#line 2", text])


def set_uniforms(program: Program, **values: Any) -> None:
    """Set uniforms by name; those that the compiler found unused are skipped."""
    for name, value in values.items():
        uniform: Any = program.get(name, None)
        if uniform is not None:
            uniform.value = value


def set_matrix(program: Program, name: str, matrix: NDArray[np.float64]) -> None:
    """Set a square matrix, (n, n) as numpy writes it; OpenGL wants columns first."""
    uniform: Any = program.get(name, None)
    if uniform is not None:
        uniform.write(np.ascontiguousarray(matrix.T, dtype=np.float32))


def set_array(program: Program, name: str, rows: Sequence[NDArray[Any]]) -> None:
    """Set a uniform array of vectors."""
    uniform: Any = program.get(name, None)
    if uniform is not None:
        uniform.write(np.ascontiguousarray(rows, dtype=np.float32))


def bind_textures(program: Program, **textures: Texture | Sequence[Texture]) -> None:
    """Give each sampler of a program its texture, and each array of samplers its textures."""
    free = 0
    for name, given in textures.items():
        bound = [given] if isinstance(given, Texture) else given
        units = np.arange(free, free + len(bound), dtype=np.int32)
        for unit, texture in zip(units, bound, strict=True):
            texture.use(int(unit))
        if name in program:
            uniform: Any = program[name]
            uniform.write(units)
        free += len(bound)


def is_released(thing: Texture | Framebuffer) -> bool:
    """Whether the object has been released."""
    return isinstance(thing.mglo, moderngl.InvalidObject)


def read_between_texels(texture: Texture) -> None:
    """Set bilinear filtering on a texture.

    Most GPUs filter with weights of 8 bits, so that a sample errs by up to 1/512 of the step to the next texel, along
    each axis; llvmpipe filters floats in float32.
    """
    texture.filter = (moderngl.LINEAR, moderngl.LINEAR)


def read_at_texels(texture: Texture) -> None:
    """Set nearest-texel sampling on a texture, the default of `GlContext.target`."""
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)


def read(texture: Texture, dtype: DTypeLike) -> NDArray[Any]:
    """A texture as (height, width, components), or (height, width) if it has one component."""
    shape = (texture.height, texture.width) + ((texture.components,) if texture.components > 1 else ())
    pixels = np.empty(shape, dtype)
    texture.read_into(pixels, alignment=1)
    return pixels


def open_context(backend: str = "auto") -> GlContext:
    """Open an OpenGL 4.3 context without a display; the context that was current stays current.

    Do not fork the process afterwards: drivers hang. Spawned workers open their own.

    Args:
        backend: "egl" (a GPU or Mesa's llvmpipe), "osmesa" (software), or "auto" for the first that opens,
            beginning with what PYOPENGL_PLATFORM names.

    Raises:
        MissingGlError: none opens; the sentence says what to install.
    """
    reasons = []
    for name in _in_order() if backend == "auto" else (backend,):
        try:
            # The buffer that an OSMesa context is current with is not known here: there is nothing to save.
            save = EglBinding().save if name == "egl" else lambda: lambda: None
            restore = save()
            try:
                with _default_context_kept():
                    ctx = _OPENERS[name]()
                current = CurrentContext((name,))
            finally:
                restore()
            return GlContext(ctx, current, OwnContext(ctx, current, save))
        except Exception as error:  # glcontext raises bare Exception, ctypes OSError, moderngl ValueError
            reasons.append(f"{name}: {error}")
    raise MissingGlError(
        f"No OpenGL 4.3 context opens ({'; '.join(reasons)}): install libegl1 and libgl1, or libosmesa6, "
        "or draw with the CPU backend."
    )


def adopt_context(context: moderngl.Context | None = None) -> GlContext:
    """Adopt the OpenGL context of another program, e.g. a viewer's or pyrender's.

    Each `drawing` block finds the context current and leaves its state as it was, up to what `gl_state` names. Neither
    ModernGL's record of that state nor its settings change, because the blocks have a ModernGL context of their own.

    Args:
        context: ModernGL's, which is made current; None for the one that is current on this thread, whoever made it.

    Raises:
        MissingGlError: none is current, it has been released, or its version is below 4.3; it stays as it was.
    """
    if context is not None:
        if isinstance(context.mglo, moderngl.InvalidObject):
            raise MissingGlError("The ModernGL context has been released: adopt one that is alive.")
        _check_version(divmod(context.version_code // 10, 10))
        make_current: Callable[[], object] = context.__enter__
        make_current()
    try:
        current = CurrentContext()
    except NoCurrentContextError as error:
        raise MissingGlError(
            f"{error}: make yours current before adopting it, or let open_context() open one."
        ) from error
    _check_version(current.version())
    state = GlState(current)
    loader: Any = current
    with state.kept(third_party=True), _default_context_kept():
        ctx = moderngl.create_context(require=_VERSION_CODE, context=loader)
    # ModernGL makes textures on its last unit unless told otherwise.
    ctx.default_texture_unit = UNITS - 1
    return GlContext(ctx, current, AdoptedContext(current, state, ctx), context)


def _check_version(found: tuple[int, int]) -> None:
    if found < _VERSION:
        raise MissingGlError(
            f"The OpenGL context has version {found[0]}.{found[1]}, the renderer needs 4.3: ask for a 4.3 core profile "
            "when it is made (moderngl.create_context(require=430)), or let open_context() open one."
        )


@contextlib.contextmanager
def _default_context_kept() -> Iterator[None]:
    """Keep the caller's `moderngl.get_context()`."""
    store: Any = vars(moderngl)["_store"]
    before = store.default_context
    try:
        yield
    finally:
        store.default_context = before


def _open(**settings: Any) -> moderngl.Context:
    return moderngl.create_context(standalone=True, require=_VERSION_CODE, **settings)


def _in_order() -> list[str]:
    """Platforms to try, PyOpenGL's first, because two platforms in one process conflict."""
    return sorted(_OPENERS, key=lambda name: name != os.environ.get("PYOPENGL_PLATFORM"))


_OPENERS: dict[str, Callable[[], moderngl.Context]] = {
    "egl": lambda: _open(backend="egl"),
    "osmesa": lambda: _open(context=OsMesaContext()),
}
