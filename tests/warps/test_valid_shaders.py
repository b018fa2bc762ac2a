"""The reference compiler of GLSL accepts the programs of a compositor; drivers accept more than the language allows."""

import shutil
import subprocess
from pathlib import Path

import gl_scenes
import numpy as np
import pytest
from warps.composing import HEAD, SMALL, Make, planar, programs_compiled, scene, viewpoint

from wlr_render.draw.gl_raster import GlRaster
from wlr_render.gl import context
from wlr_render.gl.programs import for_eyes
from wlr_render.io.atomic_files import resource
from wlr_render.warp.panel_light import PanelLight

STAGES = {"vertex_shader": "vert", "fragment_shader": "frag", "compute_shader": "comp"}
MESH_WARP = {"mesh_warp.glsl", "own_warp.glsl"}  # for other programs: test_warp_mesh.py


def compose_all_kinds(compositor: Make) -> None:
    """Compose pictures of all kinds, with three colours, an overlay, an inset and a uniformity map, and a scene."""
    model, light = planar(), PanelLight(uniformity=np.full(SMALL[::-1], 0.5), bits=10)
    given = compositor({"right": [model] * 3}, resolution=0.5, panel=light, context="egl")
    (camera,) = given.begin_frame(HEAD, viewpoint(model)).values()
    inset = camera.inset(tuple(0.4 * np.array(camera.fov_rad)), (60, 50))
    for each in (camera, inset):
        width, height = each.size_px
        picture = np.full((height, width, 3), 90, np.uint8), np.ones((height, width), np.float32)
        given.submit(*picture, camera=None if each is camera else inset)
    given.submit_overlay(np.full((4, 4, 4), 90, np.uint8), (0.3, 0.2), world_from_quad=HEAD @ gl_scenes.at(0, 0, -1))
    for given.context.computes in (False, True):
        given.compose(with_source=True)
    GlRaster(given.context, scene()).draw(gl_scenes.view())


@pytest.mark.slow
@pytest.mark.gl
def test_the_reference_compiler_accepts_every_shader(
    compositor: Make, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    compiler = shutil.which("glslangValidator")
    if compiler is None:
        pytest.skip("glslangValidator is not installed (glslang-tools).")
    compiled, of_one_eye = programs_compiled(monkeypatch), []

    def recorded(text: str, eyes: int) -> str:
        of_one_eye.append(text)
        return for_eyes(text, eyes)

    monkeypatch.setattr(context, "for_eyes", recorded)
    compose_all_kinds(compositor)
    sources = {text: STAGES[kind] for shaders in compiled for kind, text in shaders.items()}
    sources |= {for_eyes(text, 2): "comp" for text in of_one_eye}
    written = [tmp_path / f"{number}.{stage}" for number, stage in enumerate(sources.values())]
    for path, text in zip(written, sources, strict=True):
        path.write_text(text, encoding="utf-8")
    result = subprocess.run([compiler, *written], capture_output=True, text=True)
    assert result.returncode == 0, result.stdout
    included = {path.name: path.read_text(encoding="utf-8") for path in resource("shaders").glob("*.glsl")}
    # The first comment of each file, because it may include another one.
    beginnings = {name: text.split("\n\n", 1)[0] for name, text in included.items()}
    assert {name for name, text in beginnings.items() if not any(text in each for each in sources)} == MESH_WARP
