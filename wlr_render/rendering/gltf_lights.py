"""Lights in glTF: the extension KHR_lights_punctual, as dictionaries, to and from our lights.

A glTF light shines along its node's -z axis. glTF's matt surface reflects 1/pi of the light, ours all of it, so an
intensity is divided by pi.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry import transforms
from wlr_render.geometry.directions import normalised
from wlr_render.rendering.scene import Light

EXTENSION = "KHR_lights_punctual"


def lights_of_graph(path: Path, metadata: dict[str, Any], graph: Any) -> tuple[Light, ...]:
    """The lights of a scene graph that trimesh has read, world frame.

    Raises:
        BadInputError: a light that is neither directional nor a point.
    """
    listed = metadata.get("gltf_extensions", {}).get(EXTENSION, {}).get("lights", [])
    lights = []
    for (_, node), edge in graph.transforms.edge_data.items():
        used = (edge.get("metadata") or {}).get("gltf_extensions", {}).get(EXTENSION)
        if used is None:
            continue
        stated = listed[used["light"]]
        kind = stated["type"]
        if kind not in ("directional", "point"):
            raise BadInputError(f"{path}: light '{node}' is of kind '{kind}'; make it a point or directional light.")
        matrix = np.array(graph.get(node)[0], dtype=np.float64)
        vector = matrix[:3, 3] if kind == "point" else normalised(-matrix[:3, 2])
        colour = np.array(stated.get("color", (1.0, 1.0, 1.0))) * stated.get("intensity", 1.0) / np.pi
        lights.append(Light(kind, vector, colour.astype(np.float32)))
    return tuple(lights)


def scene_extension(lights: tuple[Light, ...]) -> dict[str, Any]:
    """The scene's extensions: the list of lights that nodes refer to."""
    return {EXTENSION: {"lights": [_stated(light) for light in lights]}}


def node_extension(index: int) -> dict[str, Any]:
    """The metadata by which trimesh makes a node carry light number `index`."""
    return {"gltf_extensions": {EXTENSION: {"light": index}}}


def _stated(light: Light) -> dict[str, Any]:
    """Colours are 0..1 in glTF; what is beyond goes into the intensity."""
    peak = max(float(light.colour.max()), 1e-9)
    return {"type": light.kind, "color": (light.colour / peak).tolist(), "intensity": peak * np.pi}


def world_from_light(light: Light) -> NDArray[np.float64]:
    """(4, 4) of a node that carries the light."""
    if light.kind == "point":
        return transforms.rigid(np.eye(3), light.vector)
    back = -light.vector
    right = normalised(np.cross(np.eye(3)[np.argmin(np.abs(back))], back))
    return transforms.rigid(np.stack([right, np.cross(back, right), back], axis=-1), np.zeros(3))
