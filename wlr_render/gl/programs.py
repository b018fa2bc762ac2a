"""Sources, uniforms and textures of shader programs; an unchanged uniform costs no OpenGL call."""

import ctypes
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.gl.native_contexts import CurrentContext
from wlr_render.io import atomic_files

GLSL_VERSION = 410
"""GLSL version of all shaders: OpenGL 4.1, the newest on macOS; it replaces the version that a shader file states."""


COMPUTE_VERSION = 430
"""GLSL version of compute shaders."""

MULTI_BIND_VERSION = 440
"""OpenGL 4.4 binds several textures in one call."""

UNITS = 32
"""Number of texture units that are used."""

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
    missed = [line for line in text.splitlines() if line.startswith("uniform") and not _PER_EYE.match(line)]
    if missed:
        raise ValueError(f"{missed[0]!r} is not a uniform that each eye can have; declare one name in a line.")
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
        self.has_arrays: bool | None = None  # whether samplers are in arrays; None until they have texture units

    @staticmethod
    def of(program: Any) -> "_Uniforms":
        if program.extra is None:
            program.extra = _Uniforms()
        found: _Uniforms = program.extra
        return found

    def set(self, program: Any, values: dict[str, Any]) -> None:
        """Set uniforms, see `set_uniforms`; skip uniforms that the compiler has removed."""
        if values.items() <= self._written.items():
            return
        for name, value in values.items():
            if name in self._written and self._written[name] == value:
                continue
            if name not in self._handles:
                self._handles[name] = program.get(name, None)
            uniform = self._handles[name]
            if uniform is not None and isinstance(value, list | bytes):
                uniform.write(value if isinstance(value, bytes) else _packed(value))
            elif uniform is not None:
                uniform.value = value
            self._written[name] = value


def set_uniforms(program: Any, **values: Any) -> None:
    """Set uniforms by name: numbers, tuples of numbers, or `floats`; a list for an array of these."""
    _Uniforms.of(program).set(program, values)


def floats(vectors: NDArray[Any]) -> bytes:
    """Return an array of vectors as the value of a uniform."""
    return vectors.astype(np.float32).tobytes()


def set_matrix(program: Any, name: str, matrix: NDArray[np.float64]) -> None:
    """Set a square matrix (n, n), rows first as in numpy; OpenGL expects columns first."""
    set_uniforms(program, **{name: floats(matrix.T)})


def _packed(values: list[Any]) -> bytes:
    if isinstance(values[0], bytes):
        return b"".join(values)
    numbers = np.array(values)
    return numbers.astype(np.float32 if numbers.dtype.kind == "f" else np.int32).tobytes()


def bind_textures(program: Any, **textures: Any) -> None:
    """Give each sampler of a program its texture, and each array of samplers its list; always the same samplers.

    Call it in a drawing block, and bind textures of these units in no other way: a texture that is already on its unit
    is not bound again.
    """
    uniforms, of_units = _Uniforms.of(program), list(textures.values())
    if uniforms.has_arrays is None:
        uniforms.has_arrays, unit = any(isinstance(given, list) for given in of_units), 0
        for name, given in textures.items():
            units = list(range(unit, unit + (len(given) if isinstance(given, list) else 1)))
            uniforms.set(program, {name: units})
            unit += len(units)
    if uniforms.has_arrays:
        of_units = [each for given in of_units for each in (given if isinstance(given, list) else (given,))]
    _units_of(program.ctx).bind(of_units)


def forget_textures(ctx: Any) -> None:
    """Forget all bound textures, so that they are bound again; call it when other software may have bound textures."""
    _units_of(ctx).forget()


class TextureUnits:
    """Textures on the units of a ModernGL context, from unit 0: one OpenGL call binds all that change.

    Before OpenGL 4.4, they are bound one by one.
    """

    def __init__(self, ctx: Any, current: CurrentContext) -> None:
        """Prepare for a context that is current."""
        types = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p
        self._bind = current.function("glBindTextures", *types) if ctx.version_code >= MULTI_BIND_VERSION else None
        self._names = (ctypes.c_uint * UNITS)()
        self.forget()

    def forget(self) -> None:
        """Bind all textures again from now on."""
        self._textures: list[Any] = [None] * UNITS

    def bind(self, textures: list[Any]) -> None:
        """Bind textures to the first units, and leave the other units unchanged."""
        bound, names = self._textures, self._names
        changed = [k for k, each in enumerate(textures) if bound[k] is not each]
        for k in changed:
            bound[k], names[k] = textures[k], textures[k].glo
            if self._bind is None:
                textures[k].use(k)
        if changed and self._bind is not None:
            first, count = changed[0], changed[-1] + 1 - changed[0]
            self._bind(first, count, ctypes.byref(names, ctypes.sizeof(ctypes.c_uint) * first))


def _units_of(ctx: Any) -> TextureUnits:
    units: TextureUnits = ctx.extra
    return units
