"""Traces lens files with Optiland and rayoptics, which read them themselves, and stores the rays for test_lens_files.

    pip install -e .[oracle]
    pip install rayoptics==0.9.8
    python tests/optics/make_lens_file_rays.py

Writes the two files of data/lens_files that these programs make as well (`shapes.json`, `decentred.roa`).
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.numerics.arrays import FloatArray

FOLDER = Path(__file__).resolve().parent / "data" / "lens_files"
STORED = FOLDER / "rays.npz"
WAVELENGTH_UM = 0.5875618  # where a glass by index and Abbe number is the same in all programs
RAYS = 40
OPTILAND = {
    # file: (half width of the beam in mm, largest tangent)
    "HoO-V2C18Ex27.zmx": (4.0, 0.01),
    "HoO-V2C18Ex66NEW.zmx": (4.0, 0.01),
    "shapes.json": (4.0, 0.05),
    "zemax-aspheres.zmx": (4.0, 0.05),
}
RAYOPTICS = {
    "Sasian Triplet.roa": (3.0, 0.05),
    "decentred.roa": (2.0, 0.05),
    "zemax-toroids.zmx": (4.0, 0.05),
    "codev-decentres.seq": (3.0, 0.03),
    "three-mirrors.seq": (45.0, 0.02),
}


def starting_rays(width_mm: float, tangent: float, seed: int = 5) -> tuple[NDArray[Any], Any]:
    """Origins (n, 3) in mm before the first surface, and unit directions (n, 3)."""
    rng = np.random.default_rng(seed)
    origin = np.stack([*rng.uniform(-width_mm, width_mm, (2, RAYS)), np.full(RAYS, -10.0)], axis=-1)
    direction = np.stack([*rng.uniform(-tangent, tangent, (2, RAYS)), np.ones(RAYS)], axis=-1)
    return origin, direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def make_shapes() -> None:
    """An Optiland lens of every shape that is read, each turned and shifted, and a mirror."""
    from optiland.fileio import save_optiland_file
    from optiland.optic import Optic

    system = Optic("shapes")
    exact = {"tol": 1e-14, "max_iter": 100}
    add = system.surfaces.add
    add(index=0, radius=np.inf, z=-np.inf)
    add(index=1, surface_type="even_asphere", radius=80.0, conic=-0.7, coefficients=[1e-4, -2e-6, 3e-9],
        x=0.5, y=-0.3, z=5.0, rx=0.05, ry=-0.04, rz=0.3, material="N-BK7", is_stop=True, **exact)  # fmt: skip
    add(index=2, surface_type="odd_asphere", radius=-120.0, conic=0.2, coefficients=[0.0, 2e-4, -3e-6, 1e-7],
        x=0.0, y=0.2, z=12.0, rx=-0.03, ry=0.06, material="SK16",
        **exact)  # fmt: skip
    add(index=3, surface_type="polynomial", radius=-90.0, conic=-1.5,
        coefficients=[[0.0, 0.01, -3e-4], [0.02, 1e-4, 2e-6], [4e-4, -1e-6, 1e-8]], z=17.0, rx=0.02,
        **exact)  # fmt: skip
    add(index=4, surface_type="biconic", radius_x=60.0, radius_y=-75.0, conic_x=0.4, conic_y=-1.2, z=22.0, ry=0.05,
        rz=-0.2, material="F2", **exact)  # fmt: skip
    add(index=5, surface_type="toroidal", radius_x=-110.0, radius_y=-70.0, conic=0.0, toroidal_coeffs_poly_y=[],
        z=27.0, rx=-0.04, **exact)  # fmt: skip
    add(index=6, radius=-150.0, conic=-1.0, z=45.0, rx=0.3, material="mirror")
    add(index=7, radius=np.inf, y=-20.0, z=20.0, rx=0.5)
    system.set_aperture("EPD", 8.0)
    system.fields.set_type("angle")
    system.fields.add(y=0)
    system.wavelengths.add(WAVELENGTH_UM, is_primary=True)
    save_optiland_file(system, FOLDER / "shapes.json")
    # Where Optiland is installed on this machine is nobody's business.
    content = json.loads((FOLDER / "shapes.json").read_text())
    for surface in content["surface_group"]["surfaces"]:
        surface["material_post"].pop("filename", None)
    (FOLDER / "shapes.json").write_text(json.dumps(content, indent=1) + "\n")


def trace_with_optiland(path: Path, origin: NDArray[Any], direction: FloatArray) -> NDArray[Any]:
    """Points on every surface after the object in mm, then the last direction: (n, surfaces + 1, 3)."""
    from optiland.fileio import load_optiland_file, load_zemax_file
    from optiland.rays import RealRays

    system = load_optiland_file(path) if path.suffix == ".json" else load_zemax_file(str(path))
    for surface in system.surfaces:
        surface.aperture = None
        if hasattr(surface.geometry, "tol"):
            surface.geometry.tol = 1e-14
    ones = np.ones(len(origin))
    system.surfaces.trace(RealRays(*origin.T, *direction.T, ones, WAVELENGTH_UM * ones), skip=1)
    group = system.surfaces
    points = np.stack([group.x, group.y, group.z], axis=-1)
    last = np.stack([group.L, group.M, group.N], axis=-1)[-1:]
    return np.moveaxis(np.concatenate([points, last]), 0, 1)


def make_decentred() -> None:
    """A rayoptics lens whose surfaces have each kind of decentre, with turns about all three axes.

    Not the first one: rayoptics states the place of the object before a decentred surface with the wrong sign.
    """
    from rayoptics.elem.surface import DecenterData
    from rayoptics.gui.roafile import open_roa

    model = open_roa(FOLDER / "Sasian Triplet.roa")
    kinds = ("decenter", "reverse", "dec and return", "bend")
    for number, kind in zip((2, 3, 4, 5), kinds, strict=True):
        decentre = DecenterData(kind, 0.1 * number, -0.15, 1.5, -2.0 + number, 20.0)
        decentre.update()
        model["seq_model"].ifcs[number].decenter = decentre
    model.update_model()
    model.save_model(FOLDER / "decentred.roa")


def trace_with_rayoptics(path: Path, origin: FloatArray, direction: FloatArray) -> NDArray[Any]:
    """As `trace_with_optiland`."""
    from rayoptics.codev import cmdproc
    from rayoptics.gui.roafile import open_roa
    from rayoptics.raytr.raytrace import trace
    from rayoptics.zemax import zmxread

    readers = {".roa": open_roa, ".zmx": lambda path: zmxread.read_lens_file(path)[0]}
    whole = readers.get(path.suffix, lambda path: cmdproc.read_lens(path)[0])(path)
    breaks = [each for each in whole["seq_model"].ifcs if each.interact_mode == "phantom"]
    for each in breaks:  # Zemax's tilts about x and y are right-handed; rayoptics takes them for its own, left-handed
        each.decenter.euler[:2] *= -1
        each.decenter.update()
    if path.suffix == ".seq":  # the thickness of CODE V's image, by which rayoptics does not place it
        whole["seq_model"].gaps[-1].thi += whole["optical_spec"]["focus"].focus_shift
    whole["seq_model"].gaps[0].thi = 20.0  # from 1e10 mm, rays would lose their digits
    whole.update_model()
    model = whole["seq_model"]
    frames = model.gbl_tfrms
    turn, place = frames[0]
    wavelength_nm = min(model.wvlns, key=lambda each: abs(each - 1e3 * WAVELENGTH_UM))  # as the file has it, rounded
    rays = []
    for start, head in zip(origin, direction, strict=True):
        found, *_ = trace(model, start + [0.0, 0.0, 20.0], head, wavelength_nm, check_apertures=False)
        points = [
            frames[k][0] @ segment[0] + frames[k][1]
            for k, segment in enumerate(found)
            if model.ifcs[k].interact_mode != "phantom"
        ]
        last = frames[len(found) - 1][0] @ found[-1][1]
        rays.append([*(turn.T @ (point - place) - [0.0, 0.0, 20.0] for point in points[1:]), turn.T @ last])
    return np.array(rays)


if __name__ == "__main__":
    make_shapes()
    make_decentred()
    stored = {}
    for cases, tracer in ((OPTILAND, trace_with_optiland), (RAYOPTICS, trace_with_rayoptics)):
        for name, beam in cases.items():
            start, head = starting_rays(*beam)
            stored[name] = np.concatenate([start[:, None], head[:, None], tracer(FOLDER / name, start, head)], axis=1)
            print(name, stored[name].shape, "lost:", np.isnan(stored[name]).any(axis=(1, 2)).sum())
    np.savez_compressed(STORED, allow_pickle=False, **stored)
    print(f"{STORED}: {STORED.stat().st_size / 1e3:.0f} kB")
