"""What a glTF file states and no method of ours draws."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from wlr_render.scene.gltf_arrays import GltfArrays
from wlr_render.scene.gltf_document import FLAT_MODES, LIGHTS, MOVED, GltfDocument, base_texture, has_triangles

SPOT = "spot"
"""The kind of light that is not drawn."""
_DRAWN = {
    *("name", "extras", "doubleSided", "alphaCutoff"),  # no effect on the picture
    *("pbrMetallicRoughness", "extensions"),  # their parts are looked at one by one
    *("baseColorFactor", "baseColorTexture"),
}
_MATT_AND_OPAQUE = {"metallicFactor": 0, "roughnessFactor": 1, "emissiveFactor": [0, 0, 0], "alphaMode": "OPAQUE"}
"""Values with which nothing is lost."""
_WRAPS = {33071: "CLAMP_TO_EDGE", 33648: "MIRRORED_REPEAT"}
_NEAREST = 9728
_UV_MARGIN = 1e-3  # beyond 0..1, in which no wrapping is seen


def lost_material_keys(document: GltfDocument, arrays: GltfArrays) -> Iterator[tuple[str, list[str]]]:
    """Name, and keys that are not drawn, of each material that a mesh has."""
    used: dict[int, list[dict[str, Any]]] = {}
    for mesh in document.entries("meshes"):
        for primitive in mesh["primitives"]:
            if "material" in primitive and has_triangles(primitive):
                used.setdefault(primitive["material"], []).append(primitive)
    for number in sorted(used):
        material = document.entries("materials")[number]
        surface = material.get("pbrMetallicRoughness")
        # A material that states its surface, and not how metallic it is, is a metal.
        stated = material | ({} if surface is None else {"metallicFactor": 1.0} | surface)
        keys = [key for key, value in stated.items() if key not in _DRAWN and value != _MATT_AND_OPAQUE.get(key)]
        texture = base_texture(material) or {}
        for part in (material, texture):
            keys += [key for key in part.get("extensions", {}) if key != MOVED]
        if texture:
            keys += _sampler_keys(document, texture, used[number], arrays)
        yield document.name_of("materials", number), keys


def _sampler_keys(
    document: GltfDocument, texture: dict[str, Any], primitives: list[dict[str, Any]], arrays: GltfArrays
) -> Iterator[str]:
    """Return settings of a texture's sampler that differ visibly from repeated and bilinear."""
    number = document.entry("textures", texture["index"]).get("sampler")
    sampler = {} if number is None else document.entry("samplers", number)
    for axis, key in enumerate(("wrapS", "wrapT")):
        wrap = _WRAPS.get(sampler.get(key, 0))
        if wrap is None:
            continue
        for primitive in primitives:
            coordinates = arrays.texture_coordinates(primitive)
            along = np.empty(0) if coordinates is None else coordinates[:, axis]
            if along.size and (along.min() < -_UV_MARGIN or along.max() > 1 + _UV_MARGIN):
                yield f"{key} {wrap}"
                break
    if sampler.get("magFilter") == _NEAREST:
        yield "magFilter NEAREST"


def lost_parts(document: GltfDocument) -> Iterator[str]:
    """Points, lines, morph targets, skins, spot lights, extensions of nodes, and animations."""
    nodes = [(index, document.entries("nodes")[index]) for index in document.placed_nodes()]
    weights: dict[int, list[list[float]]] = {}
    for _, node in nodes:
        if "mesh" in node:
            mesh = document.entry("meshes", node["mesh"])
            weights.setdefault(node["mesh"], []).append(node.get("weights", mesh.get("weights", [])))
    for number, mesh in enumerate(document.entries("meshes")):
        name = document.name_of("meshes", number)
        flat = [FLAT_MODES[each["mode"]] for each in mesh["primitives"] if each.get("mode") in FLAT_MODES]
        flat += ["primitives without positions" for each in mesh["primitives"] if "POSITION" not in each["attributes"]]
        yield from (f"{what} of mesh {name}" for what in dict.fromkeys(flat))
        if any(each.get("targets") for each in mesh["primitives"]) and any(map(any, weights.get(number, []))):
            yield f"morph targets of mesh {name}"
    lights = document.tree.get("extensions", {}).get(LIGHTS, {}).get("lights", [])
    for index, node in nodes:
        name = document.name_of("nodes", index)
        if "mesh" in node and "skin" in node:
            yield f"skin of node {name}"
        for key, value in node.get("extensions", {}).items():
            kind = lights[value["light"]]["type"] if key == LIGHTS else None
            if kind is None:
                yield f"{key} of node {name}"
            elif kind == SPOT:
                yield f"spot light {name}"
    animations = [document.name_of("animations", number) for number in range(len(document.entries("animations")))]
    if animations:
        yield f"animation {', '.join(animations)}"
