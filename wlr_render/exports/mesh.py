"""A triangle mesh of the panel with texture coordinates, as glTF 2.0, for engines and viewers."""

import base64
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.exports.check_pictures import CHECK_SOURCE
from wlr_render.exports.export_view import ExportedView, has_ray
from wlr_render.exports.facts import facts
from wlr_render.exports.format import Capabilities, Format, Loss
from wlr_render.io.atomic_files import write_text
from wlr_render.warp.choose_grid import choose_mesh_grid
from wlr_render.warp.grid import WarpGrid

TOLERANCE_ARCMIN = 0.1
"""Largest interpolation error: a tenth of the error at another depth; a finer mesh costs an engine more than it
gains."""
_FLOAT, _UINT32 = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
"""Component types and buffer targets of glTF."""
_LINEAR, _CLAMP = 9729, 33071
"""Filter and wrapping of glTF."""
_TYPES = {2: "VEC2", 3: "VEC3"}


class GltfMesh(Format):
    """The format `mesh`."""

    name = "mesh"
    title = "mesh with texture coordinates (glTF 2.0) for engines"
    holds = Capabilities(every_pixel=False)
    endings = ("-mesh.gltf",)
    has_all_colours = True
    convention = (
        "POSITION: x from -1 on the panel's left edge to 1 on its right edge, y from -1 on the bottom edge to 1 on the "
        "top edge, z = 0: the clip coordinates of a picture that fills the panel.",
        "TEXCOORD_0: position in the source picture, (0, 0) its top left corner and (1, 1) its bottom right corner, as "
        "glTF defines it. With a map for each colour TEXCOORD_0, _1 and _2 are for red, green and blue.",
        "Interpolate linearly within triangles. They are small enough that this errs by at most "
        f"{TOLERANCE_ARCMIN:g} arcmin, or as small as panel pixels.",
        "Triangles are counter-clockwise. Triangles with a corner without a ray are missing: show black there.",
        "extras of the file's asset has the headset, eye, viewpoint, depth, source camera and these sentences.",
    )
    use = (
        "Load the file as any glTF mesh. Draw it to the panel without light, the source picture as its texture with a "
        "linear filter, and its positions as clip coordinates.",
        f"Its texture is {CHECK_SOURCE}, so that a viewer of glTF files shows the check of this page; replace it.",
        "OpenGL: textures whose first row is the bottom one need 1 - v. Vulkan: reverse y of POSITION.",
        "With a map for each colour: a fragment shader reads the picture three times, and keeps one channel each time.",
    )

    def interpolation(self, view: ExportedView, colour: str) -> Loss:
        """Return the tolerance of the mesh."""
        return Loss("between the points of the mesh, at most", None, TOLERANCE_ARCMIN)

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write a file for each view; yield its path, see `Format`."""
        grids: dict[str, WarpGrid] = {}  # one grid per eye, for the whole eye box
        for view in views:
            if view.eye not in grids:
                grids[view.eye] = _grid(view)
            yield write_text(folder / self.files(view)[0], json.dumps(self._gltf(view, grids[view.eye])) + "\n")

    def _gltf(self, view: ExportedView, grid: WarpGrid) -> dict[str, Any]:
        camera, pixel = view.source.camera, grid.panel_pixel()
        position = np.zeros((*pixel.shape[:2], 3))
        position[..., :2] = (2 * pixel / grid.panel.size_px - 1) * [1, -1]
        source = [
            camera.pixel_of_tangents(view.tangents(np.moveaxis(view.rays_at(colour, pixel), -1, 0))) / camera.size_px
            for colour in view.colours
        ]
        is_solved = np.all([has_ray(texture) for texture in source], axis=0).ravel()
        triangles = grid.triangles()
        triangles = triangles[is_solved[triangles].all(axis=1)]
        if not len(triangles):
            raise BadInputError(
                f"{view.origin.name}: no pixel of the panel has a ray for {view.stem}; check the pupil."
            )
        attributes = {"POSITION": position.reshape(-1, 3)}
        for number, texture in enumerate(source):
            attributes[f"TEXCOORD_{number}"] = np.nan_to_num(texture.reshape(-1, 2), nan=0.0)
        return _gltf_of_mesh(attributes, triangles, facts(view, view.all_colours, self))


def _grid(view: ExportedView) -> WarpGrid:
    """Return the coarsest grid of points that is fine enough for all colours."""
    axes = view.source.device_from_camera
    grids = [choose_mesh_grid(each, axes, view.panel_size_px, TOLERANCE_ARCMIN) for each in view.channels]
    return min(grids, key=lambda each: float(each.step_px.min()))


def _gltf_of_mesh(
    attributes: dict[str, NDArray[np.float64]], triangles: NDArray[np.uint32], extras: dict[str, Any]
) -> dict[str, Any]:
    """Return a glTF 2.0 file of one mesh, its buffer embedded."""
    arrays: list[NDArray[Any]] = [*(values.astype("<f4") for values in attributes.values()), triangles.astype("<u4")]
    contents = [np.ascontiguousarray(values).tobytes() for values in arrays]
    starts = np.cumsum([0, *map(len, contents)]).tolist()
    last = len(attributes)
    buffer_views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(content), "target": _VERTICES if k < last else _INDICES}
        for k, (start, content) in enumerate(zip(starts, contents, strict=False))
    ]
    accessors: list[dict[str, Any]] = [
        {"bufferView": k, "componentType": _FLOAT, "count": len(values), "type": _TYPES[values.shape[1]]}
        for k, values in enumerate(arrays[:last])
    ]
    accessors[0] |= {"min": arrays[0].min(axis=0).tolist(), "max": arrays[0].max(axis=0).tolist()}
    accessors.append({"bufferView": last, "componentType": _UINT32, "count": triangles.size, "type": "SCALAR"})
    names = {name: k for k, name in enumerate(attributes)}
    embedded = "data:application/octet-stream;base64," + base64.b64encode(b"".join(contents)).decode()
    return {
        "asset": {"version": "2.0", "generator": "wlr_render", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "panel"}],
        "meshes": [{"primitives": [{"attributes": names, "indices": last, "material": 0}]}],
        "materials": [
            {
                "name": "source picture",
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0},
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
        "extensionsUsed": ["KHR_materials_unlit"],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"magFilter": _LINEAR, "minFilter": _LINEAR, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "images": [{"uri": CHECK_SOURCE}],
        "accessors": accessors,
        "bufferViews": buffer_views,
        "buffers": [{"byteLength": starts[-1], "uri": embedded}],
    }
