"""Somebody else's OpenGL program: it has set everything to odd values and must find them again."""

import ctypes
import os
import subprocess
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from ctypes import c_double, c_float, c_int, c_uint, c_void_p
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
from present import narrowed

# What is odd, and OpenGL's name of it for glGetDoublev (a switch is a value to it).
ODD_SWITCHES = [
    0x0BE2, 0x0C11, 0x0B71, 0x0B44, 0x0B90, 0x8DB9, 0x8C89, 0x8642, 0x8F9D, 0x864F, 0x0BF2, 0x8037, 0x2A02, 0x2A01,
    0x809E, 0x809F, 0x80A0, 0x8E51, 0x8C36, 0x0B20, 0x0B41, 0x3000, 0x3007,
]  # fmt: skip
SWITCHED_OFF = [0x0BD0, 0x809D]
READ = {
    "program": 0x8B8D, "vertex array": 0x85B5, "array buffer": 0x8894, "element buffer": 0x8895, "pack buffer": 0x88ED,
    "unpack buffer": 0x88EF, "renderbuffer": 0x8CA7, "read framebuffer": 0x8CAA, "draw framebuffer": 0x8CA6,
    "viewport": 0x0BA2, "scissor": 0x0C10, "depth range": 0x0B70, "clip origin": 0x935C, "clip depth": 0x935D,
    "depth function": 0x0B74, "depth mask": 0x0B72, "clear colour": 0x0C22, "clear depth": 0x0B73,
    "polygon mode": 0x0B40, "blend equation": 0x8009, "blend equation of alpha": 0x883D, "cull face": 0x0B45,
    "front face": 0x0B46, "restart index": 0x8F9E, "point size": 0x0B11, "line width": 0x0B21, "active unit": 0x84E0,
    "read buffer": 0x0C02, "draw buffer 0": 0x8825, "draw buffer 1": 0x8826, "cube maps": 0x884F,
    **{f"pixel store {enum:#x}": enum for enum in (*range(0x0CF0, 0x0CF6), *range(0x0D00, 0x0D06))},
}  # fmt: skip
READ_PER_BUFFER = {"colour mask": 0x0C23, "blend": 0x0BE2} | {f"blend {e:#x}": e for e in range(0x80C8, 0x80CC)}

Number = type[c_double | c_float | c_int | c_uint | c_void_p]
"""Types of the arguments of OpenGL's functions."""


def open_other(require: int = 430, backend: str = "egl") -> moderngl.Context:
    """The context of another program."""
    settings: Any = {"backend": backend}  # ModernGL's stubs ask for a dictionary as each setting
    return moderngl.create_context(standalone=True, require=require, **settings)


def make_current(context: moderngl.Context) -> None:
    enter: Callable[[], object] = context.__enter__  # without types in ModernGL's stubs
    enter()


class Caller:
    """A program with a ModernGL context of its own, and everything in it set to odd values."""

    def __init__(self) -> None:
        self.ctx = open_other()
        self.mesh = self.ctx.vertex_array(
            self.ctx.program(
                vertex_shader="#version 430\nin vec2 at; void main() { gl_Position = vec4(at, 0.5, 1.0); }",
                fragment_shader="#version 430\nlayout(location = 0) out vec4 a; layout(location = 1) out vec4 b;"
                "uniform sampler2D t; void main() { a = texture(t, gl_FragCoord.xy / 9.0); b = vec4(0.5, 1, 0, 0.5); }",
            ),
            [(self.ctx.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32)), "2f4", "at")],
            self.ctx.buffer(np.array([0, 1, 2], np.int32)),
        )
        self.textures = [self.ctx.texture((2, 2), 4, bytes(range(k, k + 16))) for k in range(32)]
        self.samplers = [self.ctx.sampler(repeat_x=False) for _ in range(32)]
        self.framebuffer = self.ctx.framebuffer(
            [self.ctx.texture((8, 8), 4) for _ in range(2)], self.ctx.depth_renderbuffer((8, 8))
        )
        self.other = self.ctx.simple_framebuffer((5, 4))
        self.pixels = self.ctx.buffer(reserve=4096)
        self.gl("glBindVertexArray", 0)
        self.gl("glBindBuffer", 0x8892, 0)

    def gl(self, name: str, *arguments: float, types: Sequence[Number] | None = None) -> int:
        address = self.ctx.mglo._context.load(name)
        types = types or [ctypes.c_float if isinstance(a, float) else ctypes.c_uint for a in arguments]
        return int(ctypes.CFUNCTYPE(ctypes.c_ubyte, *types)(address)(*arguments))

    def set_odd_values(self) -> None:
        self.framebuffer.use()
        self.framebuffer.viewport, self.framebuffer.scissor = (1, 2, 5, 3), (2, 1, 4, 5)
        masks: Any = (True, False, True, True), (False, True, True, False)  # ModernGL's stubs know a single mask
        self.framebuffer.color_mask = masks
        self.ctx.enable_only(moderngl.BLEND | moderngl.CULL_FACE)
        self.ctx.wireframe, self.ctx.front_face, self.ctx.cull_face = True, "cw", "front"
        self.ctx.polygon_offset, self.ctx.depth_func, self.ctx.point_size = (2.0, 3.0), ">", 3.0
        for enum in ODD_SWITCHES:
            self.gl("glEnable", enum)
        for enum in SWITCHED_OFF:
            self.gl("glDisable", enum)
        self.gl("glDisablei", 0x0BE2, 1)
        self.gl("glBindFramebuffer", 0x8CA8, self.other.glo)
        self.gl("glUseProgram", self.mesh.program.glo)
        self.gl("glBindVertexArray", self.mesh.glo)
        for target in (0x8892, 0x88EB, 0x88EC):
            self.gl("glBindBuffer", target, self.pixels.glo)
        self.gl("glBindRenderbuffer", 0x8D41, self.framebuffer.depth_attachment.glo)
        self.gl("glDepthRange", 1.0, 0.25, types=[ctypes.c_double] * 2)
        self.gl("glClipControl", 0x8CA2, 0x935F)
        self.gl("glDepthMask", 0)
        self.gl("glClearColor", 0.1, 0.2, 0.3, 0.4)
        self.gl("glClearDepth", 0.7, types=[ctypes.c_double])
        self.gl("glBlendFuncSeparatei", 1, 1, 0x0302, 0x0305, 0)
        self.gl("glBlendEquationSeparate", 0x800A, 0x8007)
        self.gl("glPrimitiveRestartIndex", 1)
        for enum in (*range(0x0CF0, 0x0CF2), *range(0x0D00, 0x0D02)):
            self.gl("glPixelStorei", enum, 1)
        for enum in (*range(0x0CF2, 0x0CF5), *range(0x0D02, 0x0D05)):
            self.gl("glPixelStorei", enum, 3)
        self.gl("glPixelStorei", 0x0CF5, 2)
        self.gl("glPixelStorei", 0x0D05, 8)
        for unit, (texture, sampler) in enumerate(zip(self.textures, self.samplers, strict=True)):
            texture.use(unit)
            sampler.use(unit)
        for unit, texture in enumerate(self.textures[:3]):
            self.gl("glBindImageTexture", unit, texture.glo, 0, 0, 0, 0x88B9 + unit % 2, 0x8058)
        self.gl("glActiveTexture", 0x84C0 + 8)

    def state(self) -> dict[str, Any]:
        state: dict[str, Any] = {name: self._get("glGetDoublev", [enum]) for name, enum in READ.items()}
        state |= {f"switch {enum:#x}": self.gl("glIsEnabled", enum) for enum in ODD_SWITCHES + SWITCHED_OFF}
        for name, enum in READ_PER_BUFFER.items():
            state[name] = [self._get("glGetIntegeri_v", [enum, index], ctypes.c_int) for index in range(8)]
        active = int(state["active unit"][0])
        for unit in range(32):
            self.gl("glActiveTexture", 0x84C0 + unit)
            state[f"unit {unit}"] = [self._get("glGetIntegerv", [enum], ctypes.c_int) for enum in (0x8069, 0x8919)]
        self.gl("glActiveTexture", active)
        for unit in range(6):
            parts = [
                self._get("glGetIntegeri_v", [enum, unit], ctypes.c_int) for enum in (*range(0x8F3A, 0x8F3F), 0x906E)
            ]
            state[f"image {unit}"] = parts
        state["ModernGL"] = (
            self.ctx.fbo, self.ctx.mglo.fbo, self.ctx.viewport, self.ctx.scissor, self.ctx.gc_mode,
            dict(self.ctx.includes), self.ctx.wireframe, self.ctx.polygon_offset, self.ctx.default_texture_unit,
            moderngl.get_context(),
        )  # fmt: skip
        state["error"] = self.ctx.error
        return state

    def _get(self, getter: str, enums: Sequence[int], kind: type[c_double | c_int] = ctypes.c_double) -> list[float]:
        numbers = (kind * 4)()
        self.gl(getter, *enums, ctypes.addressof(numbers), types=[*[ctypes.c_uint] * len(enums), ctypes.c_void_p])
        return list(numbers)

    def objects(self) -> list[set[int]]:
        """The numbers of the objects that live, of each kind."""
        kinds = "Texture", "Framebuffer", "Program", "Buffer", "VertexArray"
        return [{number for number in range(2000) if self.gl(f"glIs{kind}", number)} for kind in kinds]

    def draw(self) -> list[bytes]:
        """Its own picture over the last, with the state, bindings and framebuffer that it finds."""
        self.mesh.render()
        return [narrowed(attachment, moderngl.Texture).read() for attachment in self.framebuffer.color_attachments]


def assert_same(after: Mapping[str, object], before: Mapping[str, object]) -> None:
    assert {name: value for name, value in after.items() if value != before[name]} == {}


def run(script: str, **environment: str) -> str:
    """What a script prints that runs as a program of its own."""
    tests = str(Path(__file__).parent)
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = [{tests!r}]\n" + textwrap.dedent(script)],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout
