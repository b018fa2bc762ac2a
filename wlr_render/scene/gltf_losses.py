"""Content of a glTF file that is not drawn."""

from collections.abc import Iterator, Sequence
from typing import Any

from wlr_render.scene.gltf_document import LIGHTS, MOVED, GltfDocument
from wlr_render.scene.gltf_file import FLAT_MODES, SPOT, Node, Part, base_texture, light_of

_DRAWN = {
    *("name", "extras", "doubleSided", "alphaCutoff"),  # no effect on the picture
    *("pbrMetallicRoughness", "extensions"),  # their parts are checked one by one
    *("baseColorFactor", "baseColorTexture"),
}
_MATT_AND_OPAQUE = {"metallicFactor": 0, "roughnessFactor": 1, "emissiveFactor": [0, 0, 0], "alphaMode": "OPAQUE"}
"""Values of keys at which ignoring them loses nothing."""
_WRAPS = {33071: "CLAMP_TO_EDGE", 33648: "MIRRORED_REPEAT"}
_NEAREST = 9728
_UV_MARGIN = 1e-3  # distance outside 0..1 at which wrapping is not visible yet


def lost_material_keys(document: GltfDocument, parts: Sequence[Part]) -> Iterator[tuple[str, list[str]]]:
    """Yield the name of each material that a mesh uses, and its keys that are not drawn."""
    for number in sorted({part.material for part in parts if part.material is not None}):
        material = document.entry("materials", number)
        surface = material.get("pbrMetallicRoughness")
        # A material that states pbrMetallicRoughness without metallicFactor is a metal.
        stated = material | ({} if surface is None else {"metallicFactor": 1.0} | surface)
        keys = [key for key, value in stated.items() if key not in _DRAWN and value != _MATT_AND_OPAQUE.get(key)]
        texture = base_texture(material) or {}
        for part in (material, texture):
            keys += [key for key in part.get("extensions", {}) if key != MOVED]
        if texture:
            keys += _sampler_keys(document, texture, [part for part in parts if part.material == number])
        yield document.name_of("materials", number), keys


def _sampler_keys(document: GltfDocument, texture: dict[str, Any], parts: Sequence[Part]) -> Iterator[str]:
    """Yield the settings of a texture's sampler that differ visibly from repeated and bilinear."""
    number = document.entry("textures", texture["index"]).get("sampler")
    sampler = {} if number is None else document.entry("samplers", number)
    for axis, key in enumerate(("wrapS", "wrapT")):
        wrap = _WRAPS.get(sampler.get(key, 0))
        along = [part.raw.uv[:, axis] for part in parts if part.raw.uv is not None and part.raw.uv.size]
        if wrap and any(each.min() < -_UV_MARGIN or each.max() > 1 + _UV_MARGIN for each in along):
            yield f"{key} {wrap}"
    if sampler.get("magFilter") == _NEAREST:
        yield "magFilter NEAREST"


def lost_parts(document: GltfDocument, nodes: Sequence[Node]) -> Iterator[str]:
    """Yield the points, lines, morph targets, skins, spot lights, extensions of nodes, and animations."""
    placed = [(node, document.entry("nodes", node.number)) for node in nodes]
    weights: dict[int, list[list[float]]] = {}
    for _, stated in placed:
        if "mesh" in stated:
            mesh = document.entry("meshes", stated["mesh"])
            weights.setdefault(stated["mesh"], []).append(stated.get("weights", mesh.get("weights", [])))
    for number, mesh in enumerate(document.entries("meshes")):
        name = document.name_of("meshes", number)
        flat = [FLAT_MODES[each["mode"]] for each in mesh["primitives"] if each.get("mode") in FLAT_MODES]
        flat += ["primitives without positions" for each in mesh["primitives"] if "POSITION" not in each["attributes"]]
        yield from (f"{what} of mesh {name}" for what in dict.fromkeys(flat))
        if any(each.get("targets") for each in mesh["primitives"]) and any(map(any, weights.get(number, []))):
            yield f"morph targets of mesh {name}"
    for node, stated in placed:
        name = document.name_of("nodes", node.number)
        if "mesh" in stated and "skin" in stated:
            yield f"skin of node {name}"
        for key in stated.get("extensions", {}):
            light = light_of(document, node) if key == LIGHTS else None
            if light is None:
                yield f"{key} of node {name}"
            elif light["type"] == SPOT:
                yield f"spot light {name}"
    animations = [document.name_of("animations", number) for number in range(len(document.entries("animations")))]
    if animations:
        yield f"animation {', '.join(animations)}"
