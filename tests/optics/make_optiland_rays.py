"""Traces the shipped devices with Optiland, an independent ray tracer, and stores the rays for test_against_optiland.

    pip install -e .[oracle]
    python tests/optics/make_optiland_rays.py

Optiland has no parallel offset of an ellipsoid and no biconic under one common root, so that two devices are held by
stand-ins, defined here: northstar with a concentric ellipsoid for its inner surface, and the prism once with round
bases under its own anamorphic terms and once with toroids. Its frame is taken as OpenCV's, in millimetres, so that
rays run towards +z as in its own designs.
"""

from dataclasses import replace
from itertools import product
from math import comb
from pathlib import Path as FilePath

import numpy as np

from wlr_render.geometry.transforms import OPENXR_FROM_OPENCV
from wlr_render.optics.device import Interaction, Path, PlacedSurface
from wlr_render.optics.device_file import load_device
from wlr_render.optics.raised import Offset
from wlr_render.optics.sag_surfaces import AnamorphicAsphere, Toroid, XYPolynomial
from wlr_render.optics.surfaces import Conic, Ellipsoid
from wlr_render.optics.traced_mappings import TracedDisplay

STORED = FilePath(__file__).resolve().parent / "data" / "optiland_rays.npz"
WAVELENGTH_UM = 0.55
RAYS = 80
_MM = 1e3


def concentric(surface: PlacedSurface) -> PlacedSurface:
    """A concentric ellipsoid, 2.5 mm shorter in every semi-axis, for a surface 2.5 mm inside an ellipsoid."""
    if not isinstance(surface.shape, Offset):
        return surface
    base = surface.shape.base
    assert isinstance(base, Ellipsoid)
    return replace(surface, shape=Ellipsoid(base.semi_axes + surface.shape.distance))


def round_base(surface: PlacedSurface) -> PlacedSurface:
    """Both curvatures and conics of an anamorphic asphere those along y; its terms as they are."""
    shape = surface.shape
    if not isinstance(shape, AnamorphicAsphere):
        return surface
    alike = replace(shape, curvature=(shape.curvature[1],) * 2, conic=(shape.conic[1],) * 2)
    return replace(surface, shape=alike)


def toroidal(surface: PlacedSurface) -> PlacedSurface:
    """A toroid with the two radii of an anamorphic asphere."""
    shape = surface.shape
    if not isinstance(shape, AnamorphicAsphere):
        return surface
    return replace(surface, shape=Toroid(1 / shape.curvature[0], 1 / shape.curvature[1]))


STAND_INS = {
    "northstar": {"concentric": concentric},
    "freeform40": {"exact": lambda surface: surface},
    "birdbath28": {"exact": lambda surface: surface},
    "prism5701202": {"round": round_base, "toroidal": toroidal},
}


def cases() -> dict[str, tuple[Path, np.ndarray, np.ndarray]]:
    """By name: a path, and the origins and directions (n, 3) of its rays in the device frame."""
    result = {}
    for name, variants in STAND_INS.items():
        optics = load_device(name).eyes["right"]
        rng = np.random.default_rng(13)
        pixel = rng.uniform(0, 1, (RAYS, 2)) * optics.panel.pixels.size_px
        origin = optics.eye_box.at(rng.uniform(-1, 1, (RAYS, 3)))
        direction = TracedDisplay(optics, WAVELENGTH_UM).view_dir_of_pixel(pixel, origin).value
        for (variant, change), kind in product(variants.items(), ("display", "see_through")):
            path = getattr(optics.with_surfaces(change), kind)
            if path.steps:
                result[f"{name}/{variant}/{kind}"] = (path, origin, direction)
    return result


def trace_with_optiland(path: Path, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Points on every surface, then the last direction: (n, steps + 1, 3), device frame, metres."""
    from optiland.materials import IdealMaterial
    from optiland.optic import Optic
    from optiland.rays import RealRays

    system = Optic()
    system.surfaces.add(index=0, radius=np.inf, z=-np.inf)
    for number, step in enumerate(path.steps, start=1):
        material = "mirror"
        if step.interaction is Interaction.REFRACT:
            material = IdealMaterial(n=step.medium.index(WAVELENGTH_UM))
        system.surfaces.add(index=number, material=material, is_stop=number == 1, **_surface(step.surface))
    start, head = _MM * origin @ OPENXR_FROM_OPENCV, direction @ OPENXR_FROM_OPENCV
    ones = np.ones(len(start))
    rays = RealRays(*start.T, *head.T, ones, WAVELENGTH_UM * ones)
    system.surfaces.trace(rays, skip=1)
    group = system.surfaces
    points = np.stack([group.x, group.y, group.z], axis=-1) / _MM
    last = np.stack([group.L, group.M, group.N], axis=-1)[-1:]
    return np.moveaxis(np.concatenate([points, last]), 0, 1) @ OPENXR_FROM_OPENCV


def _surface(surface: PlacedSurface) -> dict[str, object]:
    """Optiland's arguments for a surface: shape and place."""
    rotation = OPENXR_FROM_OPENCV @ surface.device_from_surface[:3, :3]
    origin = OPENXR_FROM_OPENCV @ surface.device_from_surface[:3, 3]
    shape = surface.shape
    arguments: dict[str, object] = {}
    if isinstance(shape, Conic):
        arguments = {"radius": _radius_mm(shape.curvature), "conic": shape.conic}
    elif isinstance(shape, Ellipsoid):
        across, _, along = shape.semi_axes
        origin = origin - rotation[:, 2] * along  # its vertex at -z, which the used part surrounds
        arguments = {"radius": _MM * across**2 / along, "conic": (across / along) ** 2 - 1}
    elif isinstance(shape, Toroid):
        arguments = {"surface_type": "toroidal", "radius_x": _MM * shape.radius_x, "radius_y": _MM * shape.radius_y}
    elif isinstance(shape, XYPolynomial):
        arguments = _polynomial(shape.coefficients, shape.curvature, shape.conic)
    elif isinstance(shape, AnamorphicAsphere):
        arguments = _polynomial(_expanded(shape), shape.curvature[0], shape.conic[0])
    if "surface_type" in arguments:
        arguments |= {"tol": 1e-14, "max_iter": 100}
    x, y, z = _MM * origin
    # Optiland turns by Rz Ry Rx.
    angles = {
        "rx": np.arctan2(rotation[2, 1], rotation[2, 2]),
        "ry": np.arcsin(-rotation[2, 0]),
        "rz": np.arctan2(rotation[1, 0], rotation[0, 0]),
    }
    return {**arguments, "x": x, "y": y, "z": z, **angles}


def _radius_mm(curvature: float) -> float:
    return np.inf if curvature == 0.0 else _MM / curvature


def _polynomial(coefficients: np.ndarray, curvature: float, conic: float) -> dict[str, object]:
    m, n = np.indices(coefficients.shape)
    in_mm = coefficients * _MM ** (1.0 - m - n)
    return {"surface_type": "polynomial", "radius": _radius_mm(curvature), "conic": conic, "coefficients": in_mm}


def _expanded(shape: AnamorphicAsphere) -> np.ndarray:
    """The anamorphic terms as coefficients of x^m y^n."""
    order = max(term.order for term in shape.terms)
    result = np.zeros((order + 1, order + 1))
    for term in shape.terms:
        power, amplitude = term.order // 2, term.sag_mm * _MM ** (term.order - 1)
        for k in range(power + 1):
            weight = comb(power, k) * (1 - term.asymmetry) ** (power - k) * (1 + term.asymmetry) ** k
            result[2 * (power - k), 2 * k] += amplitude * weight
    return result


if __name__ == "__main__":
    STORED.parent.mkdir(exist_ok=True)
    stored = {}
    for name, (path, origin, direction) in cases().items():
        start = np.stack([origin, direction], axis=1)
        stored[name] = np.concatenate([start, trace_with_optiland(path, origin, direction)], axis=1)
    np.savez_compressed(STORED, allow_pickle=False, **stored)
    print(f"{STORED}: {STORED.stat().st_size / 1e3:.0f} kB")
