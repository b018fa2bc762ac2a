"""OpenGL for drawing modules: contexts to open or adopt, render targets, texture reads, and ModernGL's names.

Every image on the GPU has its top row first, as in numpy, because the projection in `shaders/scene.vert` is flipped;
so textures are read and written here without flips.
"""

import contextlib
import ctypes
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import DTypeLike, NDArray

from wlr_render.errors import MissingGlError
from wlr_render.gl.context import SRGB8_ALPHA8
from wlr_render.gl.context import Buffer as Buffer
from wlr_render.gl.context import ComputeShader as ComputeShader
from wlr_render.gl.context import Context as Context
from wlr_render.gl.context import Framebuffer as Framebuffer
from wlr_render.gl.context import GlContext as GlContext
from wlr_render.gl.context import Program as Program
from wlr_render.gl.context import Sampler as Sampler
from wlr_render.gl.context import Texture as Texture
from wlr_render.gl.context import TextureArray as TextureArray
from wlr_render.gl.context import VertexArray as VertexArray
from wlr_render.gl.dispatches import Dispatch
from wlr_render.gl.gl_errors import ErrorReader
from wlr_render.gl.gl_errors import GlError as GlError
from wlr_render.gl.native_contexts import (
    BINDINGS,
    CurrentContext,
    NativeContext,
    NoCurrentContextError,
    OsMesaBinding,
)
from wlr_render.gl.ownership import Host, HostContext, OwnContext
from wlr_render.gl.programs import GLSL_VERSION
from wlr_render.gl.programs import bind_textures as bind_textures
from wlr_render.gl.programs import floats as floats
from wlr_render.gl.programs import set_matrix as set_matrix
from wlr_render.gl.programs import set_uniforms as set_uniforms

_FRAMEBUFFER = 0x8D40
_VERSION = divmod(GLSL_VERSION // 10, 10)


def is_srgb(texture: Texture) -> bool:
    """Return whether the texture was made by `GlContext.target` with sRGB codes."""
    return bool(texture.extra == SRGB8_ALPHA8)


def is_released(thing: Texture | TextureArray | Framebuffer) -> bool:
    """Return whether the object has been released."""
    return isinstance(thing.mglo, moderngl.InvalidObject)


def read_between_texels(texture: Texture) -> None:
    """Set bilinear filtering on a texture.

    Most GPUs filter with weights of 8 bits, so the error of a sample is up to 1/512 of the step to the next texel,
    along each axis; llvmpipe filters floats in float32.
    """
    if texture.filter != (moderngl.LINEAR, moderngl.LINEAR):
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)


def make_mip_levels(texture: Texture) -> None:
    """Allocate the mip levels of a texture and set trilinear filtering, once.

    The driver fills the levels with its own filter.
    """
    trilinear = moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR
    if texture.filter != trilinear:
        texture.build_mipmaps()
        texture.filter = trilinear


def read(texture: Texture, dtype: DTypeLike) -> NDArray[Any]:
    """Return a texture as (height, width, components), or (height, width) if it has one component."""
    shape = (texture.height, texture.width) + ((texture.components,) if texture.components > 1 else ())
    pixels = np.empty(shape, dtype)
    texture.read_into(pixels, alignment=1)
    return pixels


@dataclass(frozen=True, eq=False)
class RenderTarget:
    """A framebuffer and its textures, in the order of the shader's outputs."""

    framebuffer: Framebuffer
    textures: tuple[Texture, ...]


class Pass:
    """A full-screen shader that fills a target of ours; a compute shader if `GlContext.computes`."""

    def __init__(self, context: GlContext, name: str, /, **constants: float) -> None:
        """Compile a compute shader, or a fragment shader without derivatives, of shaders/."""
        self._context, self._name, self._constants = context, name, constants
        self._compiled: dict[bool, ComputeShader | VertexArray] = {}
        self._shader()  # compiled now, so that no frame waits for it

    def fill(self, target: RenderTarget, textures: Mapping[str, Any], **uniforms: Any) -> None:
        """Compute all texels of a target, with `textures` and `uniforms` as of `Dispatch`."""
        shader = self._shader()
        if isinstance(shader, ComputeShader):
            self._context.dispatches.add(Dispatch(shader, target.textures, textures, uniforms))
            return
        bind_textures(shader.program, **textures)
        set_uniforms(shader.program, **uniforms)
        self._context.draw_to(target.framebuffer)
        shader.render(vertices=3)

    def _shader(self) -> ComputeShader | VertexArray:
        computes = self._context.computes
        if computes not in self._compiled:
            make = self._context.compute_program if computes else self._context.full_screen
            self._compiled[computes] = make(self._name, **self._constants)
        return self._compiled[computes]


class RenderTargets:
    """Targets by name; a target is made once for each size, and the next drawing overwrites it."""

    def __init__(self, context: GlContext) -> None:
        self._context = context
        self._targets: dict[str, RenderTarget] = {}

    def get(
        self, name: str, size: tuple[int, int], *formats: tuple[int, str], with_depth: bool = False
    ) -> RenderTarget:
        """Return the target of a name and size (width, height).

        Args:
            name: name of the target, which keeps its formats.
            size: (width, height) in pixels.
            formats: components and dtype of each texture, see `GlContext.target`.
            with_depth: True to attach a depth texture.
        """
        target = self._targets.get(name)
        if target is None or target.framebuffer.size != size:
            textures = [self._context.target(size, *each) for each in formats]
            depth = self._context.depth_target(size) if with_depth else None
            target = self._targets[name] = RenderTarget(self._context.framebuffer(textures, depth), tuple(textures))
        return target


def open_context(backend: str = "auto") -> GlContext:
    """Open an OpenGL 4.1 context without a display; the context that was current stays current.

    Do not fork the process afterwards: drivers hang. A spawned worker must open another context.

    Args:
        backend: "egl" (a GPU or Mesa's llvmpipe), "osmesa" (software), or "auto" for the first that opens, beginning
            with the platform in PYOPENGL_PLATFORM.

    Raises:
        MissingGlError: no context opens; the message names the packages to install.
    """
    reasons = []
    for name in _in_order() if backend == "auto" else (backend,):
        try:
            save = BINDINGS[name]().save
            restore = save()
            try:
                with _default_context_kept():
                    ctx = _OPENERS[name]()
                current = CurrentContext((name,))
            finally:
                restore()
            return GlContext(ctx, current, OwnContext(ctx, current, save))
        except NoCurrentContextError:
            reasons.append(f"{name}: another platform's context is current on this thread; release it, or adopt it")
        except Exception as error:  # glcontext raises Exception, ctypes OSError, moderngl ValueError
            reasons.append(f"{name}: {error}")
    raise MissingGlError(
        f"No OpenGL 4.1 context opens ({'; '.join(reasons)}): install libegl1 and libgl1, or libosmesa6, "
        "or draw ray-traced frames (--backend cpu)."
    )


def adopt_context(context: moderngl.Context | None = None, host_is_clean: bool = False) -> GlContext:
    """Open a context that shares textures with another program's, e.g. a viewer's or pyrender's.

    The host's state is not touched: each `drawing` block makes the new context current, and the host's at the end.

    Args:
        context: ModernGL context, which is made current; None for the context that is current on this thread, whoever
            made it.
        host_is_clean: True to draw in the host's own context instead, for drivers that cannot share. The host
            guarantees OpenGL's default state when it enters a block, and relies on no binding afterwards
            (docs/realtime.md has the list); only blocks that make objects, in the first frames, read errors.

    Raises:
        MissingGlError: no context is current, the context has been released, the driver does not share, or a clean
            host's version is below 4.1; the host's context is unchanged.
    """
    if context is not None:
        if isinstance(context.mglo, moderngl.InvalidObject):
            raise MissingGlError("The ModernGL context has been released: adopt one that is alive.")
        make_current: Callable[[], object] = context.__enter__
        make_current()
    try:
        host = CurrentContext()
    except NoCurrentContextError as error:
        raise MissingGlError(
            f"{error}: make yours current before adopting it, or open one with context='egl'."
        ) from error
    return _in_host(host, context) if host_is_clean else _beside(host, context)


def _beside(host: CurrentContext, caller: moderngl.Context | None) -> GlContext:
    try:
        if host.platform not in BINDINGS:
            raise OSError(f"no sharing with {host.platform.upper()}")
        binding = BINDINGS[host.platform]()
        native, restore = binding.shared(), binding.save()
        try:
            ctx, current = _wrapped(native), CurrentContext((host.platform,))
        except ValueError:  # ModernGL requires a newer OpenGL
            native.release()
            raise
        finally:
            restore()
    except (OSError, ValueError) as error:
        major, minor = host.version()
        raise MissingGlError(
            f"No OpenGL 4.1 context opens that shares textures with yours of version {major}.{minor} ({error}): "
            "promise OpenGL's default state with host_state='clean' (docs/realtime.md), or submit arrays to a "
            "compositor with context='egl'."
        ) from error
    return GlContext(ctx, current, OwnContext(ctx, current, binding.save, Host(host)), caller)


def _in_host(host: CurrentContext, caller: moderngl.Context | None) -> GlContext:
    _check_version(host.version())
    loader: Any = host
    with _default_context_kept():
        # ModernGL queries the bound framebuffer's size as if its image were a plain texture: an OpenGL error if the
        # image has samples or layers.
        host.function("glBindFramebuffer", *[ctypes.c_uint] * 2)(_FRAMEBUFFER, 0)
        ctx = moderngl.create_context(require=GLSL_VERSION, context=loader)
        ErrorReader(host).take()  # ModernGL's initialisation may cause errors, which are not the host's
    return GlContext(ctx, host, HostContext(ctx, host), caller, host_is_clean=True)


def _check_version(found: tuple[int, int]) -> None:
    if found < _VERSION:
        raise MissingGlError(
            f"The OpenGL context has version {found[0]}.{found[1]}, the renderer needs 4.1: ask for a 4.1 core profile "
            "when it is made (moderngl.create_context(require=410)), or open one with context='egl'."
        )


@contextlib.contextmanager
def _default_context_kept() -> Iterator[None]:
    """Restore the caller's `moderngl.get_context()` at the end of a block."""
    store: Any = vars(moderngl)["_store"]
    before = store.default_context
    try:
        yield
    finally:
        store.default_context = before


def _wrapped(native: NativeContext) -> moderngl.Context:
    loader: Any = native
    native.make_current()
    with _default_context_kept():
        return moderngl.create_context(require=GLSL_VERSION, context=loader)


def _open(**settings: Any) -> moderngl.Context:
    return moderngl.create_context(standalone=True, require=GLSL_VERSION, **settings)


def _in_order() -> list[str]:
    """Return the platforms to try, PyOpenGL's first, because two platforms in one process conflict."""
    return sorted(_OPENERS, key=lambda name: name != os.environ.get("PYOPENGL_PLATFORM"))


_OPENERS: dict[str, Callable[[], moderngl.Context]] = {
    "egl": lambda: _open(backend="egl"),
    "osmesa": lambda: _wrapped(OsMesaBinding().opened()),
}
