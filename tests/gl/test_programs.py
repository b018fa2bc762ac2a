"""Textures that are not bound again, framebuffers bound without ModernGL, and passes as compute shaders."""

from collections.abc import Callable
from pathlib import Path

import moderngl
import numpy as np
import pytest

from wlr_render.gl import gl
from wlr_render.gl.context import GlContext
from wlr_render.gl.dispatches import Dispatch
from wlr_render.gl.programs import UNITS, for_eyes
from wlr_render.io import atomic_files


@pytest.fixture
def copying(gl_context: GlContext) -> Callable[[moderngl.Texture, moderngl.Framebuffer], None]:
    """A function that draws a texture's colour into a framebuffer, with the tools of frames."""
    with gl_context.drawing() as ctx:
        program = ctx.program(
            vertex_shader="#version 410\nvoid main() "
            "{ gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }",
            fragment_shader="#version 410\nuniform sampler2D t; out vec4 c; void main() { c = texture(t, vec2(0.5)); }",
        )
        triangle = ctx.vertex_array(program, [])

    def copy(texture: moderngl.Texture, framebuffer: moderngl.Framebuffer) -> None:
        gl_context.draw_to(framebuffer)
        gl.bind_textures(program, t=texture)
        triangle.render(vertices=3)

    return copy


@pytest.mark.gl
def test_each_draw_gets_its_texture_and_its_target(
    gl_context: GlContext, copying: Callable[[moderngl.Texture, moderngl.Framebuffer], None]
) -> None:
    with gl_context.drawing() as ctx:
        red, green = (ctx.texture((1, 1), 4, bytes(pixel)) for pixel in ([255, 0, 0, 255], [0, 255, 0, 255]))
        textures = [gl_context.target((2, 2), 4, "f1") for _ in range(5)]
        targets = [gl_context.framebuffer([texture]) for texture in textures]
        copying(red, targets[0])
        copying(green, targets[1])
        copying(green, targets[2])
        with gl_context.drawing(third_party=True):
            red.use(0)
        copying(green, targets[3])
        targets[4].viewport = (0, 0, 2, 1)
        copying(red, targets[4])
        shown = [gl.read(texture, np.uint8)[..., :2] for texture in textures]
    for picture, colour in zip(shown[:4], ([255, 0], [0, 255], [0, 255], [0, 255]), strict=True):
        assert (picture == colour).all()
    assert (shown[4][0] == [255, 0]).all()
    assert (shown[4][1] == 0).all()


@pytest.mark.gl
@pytest.mark.parametrize("at_once", [True, False], ids=["in one call", "one by one"])
def test_several_textures_reach_their_samplers_whichever_of_them_change(
    gl_context: GlContext, monkeypatch: pytest.MonkeyPatch, at_once: bool
) -> None:
    with gl_context.drawing() as ctx:
        if not at_once:  # as before OpenGL 4.4
            monkeypatch.setattr(ctx.extra, "_bind", None)
        program = ctx.program(
            vertex_shader="#version 410\nvoid main() "
            "{ gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }",
            fragment_shader="#version 410\nuniform sampler2D a, b, c; out vec4 seen; void main() "
            "{ vec2 at = vec2(0.5); seen = vec4(texture(a, at).r, texture(b, at).r, texture(c, at).r, 1.0); }",
        )
        triangle = ctx.vertex_array(program, [])
        textures = [ctx.texture((1, 1), 1, bytes([code])) for code in (10, 20, 30, 40)]
        target = gl_context.target((1, 1), 4, "f1")
        framebuffer = gl_context.framebuffer([target])
        # All change, none, the ends, the last, all but the first, and two samplers share one that was elsewhere.
        for given in ([0, 1, 2], [0, 1, 2], [3, 1, 0], [3, 1, 2], [3, 0, 1], [2, 2, 0]):
            gl_context.draw_to(framebuffer)
            gl.bind_textures(program, **dict(zip("abc", (textures[k] for k in given), strict=True)))
            triangle.render(vertices=3)
            seen = gl.read(target, np.uint8)[0, 0, :3]
            assert seen.tolist() == [10 * (k + 1) for k in given], given


@pytest.mark.gl
def test_textures_are_bound_anew_in_each_block(
    gl_context: GlContext, copying: Callable[[moderngl.Texture, moderngl.Framebuffer], None]
) -> None:
    with gl_context.drawing() as ctx:
        red, green = (ctx.texture((1, 1), 4, bytes(pixel)) for pixel in ([255, 0, 0, 255], [0, 255, 0, 255]))
        texture = gl_context.target((2, 2), 4, "f1")
        target = gl_context.framebuffer([texture])
        copying(green, target)
    with vars(gl_context)["_owner"].entered():
        red.use(0)  # as a host does between our calls
    with gl_context.drawing():
        copying(green, target)
        assert (gl.read(texture, np.uint8) == [0, 255, 0, 255]).all()


@pytest.mark.gl
@pytest.mark.parametrize(
    ("kind", "value", "dtype", "texel"),
    [
        ("float", "2.5", "f4", [2.5]),
        ("int", "-3", "i4", [-3]),
        ("uint", "7u", "u1", [7]),
        ("vec2", "vec2(1.5, 2.5)", "f4", [1.5, 2.5]),
        ("vec3", "vec3(1.5, 2.5, 3.5)", "f4", [1.5, 2.5, 3.5, 0]),
        ("ivec2", "ivec2(-1, 2)", "i4", [-1, 2]),
        ("uvec4", "uvec4(1, 2, 3, 4)", "u1", [1, 2, 3, 4]),
    ],
)
def test_a_computed_pass_writes_outputs_of_every_type(
    gl_context: GlContext,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    value: str,
    dtype: str,
    texel: list[float],
) -> None:
    shader = tmp_path / f"{kind}.frag"
    shader.write_text(
        f"#version 410\nlayout(location = 0) out {kind} written;\nvoid main()\n{{\n    written = {value};\n}}\n"
    )
    monkeypatch.setattr(atomic_files, "resource", lambda folder, name: tmp_path / name)
    with gl_context.drawing():
        target = gl_context.target((3, 2), len(texel), dtype)
        gl_context.dispatches.add(Dispatch(gl_context.compute_program(shader.name), [target], {}, {}))
        assert (gl.read(target, dtype).reshape(6, -1) == texel).all()


def test_a_uniform_that_all_eyes_would_share_is_refused() -> None:
    with pytest.raises(ValueError, match="uniform vec2 a, b"):
        for_eyes("#version 430\nuniform vec2 a, b;\nvoid main() {}\n", 2)


@pytest.mark.gl
def test_textures_are_written_on_a_unit_that_no_shader_reads(gl_context: GlContext) -> None:
    assert gl_context.texture_unit == UNITS - 1 >= 2 * 14  # 14 textures for each of two eyes
