"""Sources, uniforms and textures of shader programs; an unchanged uniform costs no OpenGL call."""

import ctypes
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.gl.native_contexts import CurrentContext
from wlr_render.io import atomic_files

GLSL_VERSION = 410
"""GLSL version of all shaders: OpenGL 4.1, the newest on macOS; it replaces the version that a shader file states."""


COMPUTE_VERSION = 430
"""GLSL version of compute shaders: OpenGL 4.3."""

MULTI_BIND_VERSION = 440
"""OpenGL 4.4 binds several textures in one call."""

_INCLUDE = re.compile(r'^#include "(\w+\.glsl)"$', re.MULTILINE)


def shader_source(name: str, constants: dict[str, float]) -> str:
    """Return the text of a file in shaders/, with `#define NAME value` for each constant."""
    _, text = _text(name).split("\n", 1)
    defines = (f"#define {key} {value}" for key, value in constants.items())
    version = COMPUTE_VERSION if name.endswith(".comp") else GLSL_VERSION
    return "\n".join([f"#version {version}", *defines, "#line 2", _with_includes(text)])


_OUTPUT = re.compile(r"^layout\(location = (\d)\) out (float|u?int|[iu]?vec[234]) (\w+);", re.MULTILINE)


def pass_source(name: str, group: int, constants: dict[str, float]) -> str:
    """Return a full-screen fragment shader as the text of a compute shader with images as outputs, in square groups."""
    _, text = shader_source(name, constants).split("\n", 1)
    images, stores = [], []
    for unit, kind, output in _OUTPUT.findall(text):
        prefix, components = kind[0] if kind[0] in "iu" else "", int(kind[-1]) if "vec" in kind else 1
        images.append(f"layout(binding = {unit}) uniform writeonly {prefix}image2D image_{unit};")
        stores.append(f"imageStore(image_{unit}, texel, {prefix}vec4({output}{', 0' * (4 - components)}));")
    before = [f"#version {COMPUTE_VERSION}", f"layout(local_size_x = {group}, local_size_y = {group}) in;"]
    after = ["void main() {", "ivec2 texel = ivec2(gl_GlobalInvocationID.xy);"]
    after += ["if (any(greaterThanEqual(texel, imageSize(image_0)))) return;"]
    after += ["at_fragment = vec4(vec2(texel) + 0.5, 0.0, 1.0);", "fill();", *stores, "}", ""]
    text = _OUTPUT.sub(r"\2 \3;", text).replace("void main()", "void fill()").replace("gl_FragCoord", "at_fragment")
    return "\n".join([*before, *images, "vec4 at_fragment;", text, *after])


_PER_EYE = re.compile(r"^((?:uniform \w+|TEXTURE\(\d\)) )(\w+)(?:\[([^\]]+)\])?;", re.MULTILINE)
_IMAGE = re.compile(r"^layout\(binding = (\d)\) uniform writeonly (\w+) (\w+);", re.MULTILINE)


def for_eyes(text: str, eyes: int) -> str:
    """Return a compute shader that serves several eyes in one dispatch: the eye is the work group's z.

    Each uniform, sampler or image `name` becomes an array over the eyes, `of_eyes(name)`; image k of the first eye is
    bound to unit k * eyes.
    """
    version, text = text.split("\n", 1)
    names = [(found[2], found[3]) for found in _PER_EYE.finditer(text)] + [
        (each[2], "") for each in _IMAGE.findall(text)
    ]
    text = _PER_EYE.sub(lambda found: f"{found[1]}{of_eyes(found[2])}[{eyes} * ({found[3] or 1})];", text)
    text = _IMAGE.sub(
        lambda found: (
            f"layout(binding = {eyes * int(found[1])}) uniform writeonly {found[2]} {of_eyes(found[3])}[{eyes}];"
        ),
        text,
    )
    for name, count in names:
        if count:
            text = re.sub(rf"\b{name}\[([^\]]+)\]", rf"{of_eyes(name)}[EYE * ({count}) + \1]", text)
        else:
            text = re.sub(rf"\b{name}\b", f"{of_eyes(name)}[EYE]", text)
    eye = "int(gl_WorkGroupID.z)" if eyes > 1 else "0"
    return f"{version}\n#define EYE {eye}\n{text}"


def of_eyes(name: str) -> str:
    """Return the name of the array of a uniform's values for several eyes."""
    return f"{name}_of_eyes"


def _with_includes(text: str) -> str:
    """Replace each include line by the text of the file, recursively."""
    return _INCLUDE.sub(lambda found: _with_includes(_text(found[1])), text)


def _text(name: str) -> str:
    return atomic_files.resource("shaders", name).read_text(encoding="utf-8")


class _Uniforms:
    """Uniforms of a program by name, with their last values: an unchanged value costs no OpenGL call."""

    def __init__(self) -> None:
        self._handles: dict[str, Any] = {}
        self._written: dict[str, object] = {}
        self.units: dict[str, Any] = {}  # texture units of each sampler

    @staticmethod
    def of(program: Any) -> "_Uniforms":
        if program.extra is None:
            program.extra = _Uniforms()
        found: _Uniforms = program.extra
        return found

    def is_set(self, name: str, value: object) -> bool:
        """Return whether a uniform has this value."""
        return name in self._written and self._written[name] == value

    def set(self, program: Any, name: str, value: object, data: bytes | None = None) -> None:
        """Set a uniform to a value, or to an array of `data`; skip a uniform that the compiler has removed."""
        new = data if value is None else value
        if self.is_set(name, new):
            return
        if name not in self._handles:
            self._handles[name] = program.get(name, None)
        uniform = self._handles[name]
        if uniform is not None:
            if data is None:
                uniform.value = value
            else:
                uniform.write(data)
        self._written[name] = new


def set_uniforms(program: Any, **values: Any) -> None:
    """Set uniforms by name: numbers, tuples of numbers, or arrays of vectors; skip those that the compiler removed."""
    uniforms = _Uniforms.of(program)
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            uniforms.set(program, name, None, _floats(value))
        else:
            uniforms.set(program, name, value)


def set_matrix(program: Any, name: str, matrix: NDArray[np.float64]) -> None:
    """Set a square matrix (n, n), rows first as in numpy; OpenGL expects columns first."""
    set_uniforms(program, **{name: matrix.T})


def _floats(values: NDArray[Any]) -> bytes:
    return values.astype(np.float32).tobytes()


def set_of_eyes(program: Any, name: str, values: Sequence[Any]) -> None:
    """Set a uniform of a program `for_eyes` to the values of its eyes: numbers, tuples, or arrays of vectors."""
    if isinstance(values[0], np.ndarray):
        set_uniforms(program, **{of_eyes(name): np.concatenate(values)})
        return
    uniforms, name = _Uniforms.of(program), of_eyes(name)
    if not uniforms.is_set(name, values):
        numbers = np.array(values)
        kind = np.float32 if numbers.dtype.kind == "f" else np.int32
        uniforms.set(program, name, values, numbers.astype(kind).tobytes())


def bind_textures(program: Any, **textures: Any) -> None:
    """Give each sampler of a program its texture, and each array of samplers its textures, always the same samplers.

    Call it in a drawing block, and bind textures of these units in no other way: a texture that is already on its unit
    is not bound again.
    """
    uniforms = _Uniforms.of(program)
    of_units: list[Any] = []
    for name, given in textures.items():
        several = given if isinstance(given, list) else [given]
        if name not in uniforms.units:
            uniforms.units[name] = np.arange(len(several), dtype=np.int32) + len(of_units)
            uniforms.set(program, name, None, uniforms.units[name].tobytes())
        of_units += several
    _units_of(program.ctx).bind(of_units)


def forget_textures(ctx: Any) -> None:
    """Forget all bound textures, so that they are bound again; call it when other software may have bound textures."""
    _units_of(ctx).textures.clear()


class TextureUnits:
    """Textures on the units of a ModernGL context, from unit 0: one OpenGL call binds all that change.

    Before OpenGL 4.4, they are bound one by one.
    """

    def __init__(self, ctx: Any, current: CurrentContext) -> None:
        """Prepare for a context that is current."""
        self.textures: list[Any] = []
        types = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
        self._bind = current.function("glBindTextures", *types) if ctx.version_code >= MULTI_BIND_VERSION else None

    def bind(self, textures: list[Any]) -> None:
        """Bind textures to the first units, and leave the other units unchanged."""
        bound = self.textures
        if bound[: len(textures)] == textures:
            return
        changed = [k for k, each in enumerate(textures) if k >= len(bound) or bound[k] is not each]
        if self._bind is not None:
            first, end = changed[0], changed[-1] + 1
            names = (ctypes.c_uint * (end - first))(*[each.glo for each in textures[first:end]])
            self._bind(first, end - first, ctypes.addressof(names))
        else:
            for k in changed:
                textures[k].use(k)
        bound[: len(textures)] = textures


def _units_of(ctx: Any) -> TextureUnits:
    units: TextureUnits = ctx.extra
    return units
