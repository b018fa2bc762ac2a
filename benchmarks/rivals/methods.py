"""All methods by name: their fits to the same captures of one eye, and their sources."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from benchmarks.rivals.distortion_field import distortion_field
from benchmarks.rivals.kernels import free_kernel_ridge, gaussian_process, kernel_ridge
from benchmarks.rivals.map_tables import linear_table, principal_components, thin_plate_table
from benchmarks.rivals.networks import decoded_components, network, offset_network
from benchmarks.rivals.pinhole import direct_plane, indica_full, indica_recycle, spaam, spaam_redone
from benchmarks.rivals.pinhole_models import FixedEyeSeeThrough, PinholeDisplay
from benchmarks.rivals.plane_and_polynomial import wientapper_display, wientapper_see_through
from benchmarks.rivals.point_table import klemm_grid
from benchmarks.rivals.samples import Fit, fit_structure
from wlr_render.calibration.fit_display import DISPLAY, fit_display
from wlr_render.calibration.fit_eye import eye_trends, fit_with_trends
from wlr_render.calibration.fit_prescription import FittedAssembly, Prescription, fit_assembly
from wlr_render.calibration.fit_see_through import SEE_THROUGH, fit_see_through
from wlr_render.captures.correspondences import Captures
from wlr_render.mappings import DisplayMapping, SeeThroughMapping
from wlr_render.models.see_through_model import undeviated
from wlr_render.optics.assembly import ASSEMBLY_NAMES
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough
from wlr_render.simulation.capture_setup import CaptureSetup
from wlr_render.simulation.simulate_captures import simulate_display, simulate_see_through

STRUCTURES = ("static", "volumetric", "planar")
SHAPE = 0.002
"""Relative error of a semi-axis or curvature of each surface, for methods that use a prescription with wrong shapes."""
TRACED_POSITIONS = 100
"""Number of positions from which rays are traced through a prescription."""
_WAVELENGTH_UM = 0.55
_NETWORK_S = 1.0  # process time for each side, seconds


@dataclass(frozen=True, eq=False)
class MethodData:
    """Inputs of the methods.

    Attributes:
        planar: captures from camera positions in a plane.
        volumetric: captures from as many positions in the eye box.
        drawn: function of a relative shape error that returns the prescription as drawn. The parts of the real headset
            are displaced, and its surfaces differ by that error. Raises BadInputError for surfaces without such an
            error.
        bench_of: function of a prescription that returns a bench with it in place of the headset, for methods that fit
            traced rays.
    """

    planar: Captures
    volumetric: Captures
    drawn: Callable[[float], Prescription]
    bench_of: Callable[[Prescription], CaptureSetup]

    def of(self, structure: str) -> Captures:
        """Return the captures that a structure is fitted to."""
        return self.volumetric if structure == "volumetric" else self.planar

    @cached_property
    def _assemblies(self) -> dict[float, tuple[FittedAssembly, float]]:
        return {}

    def assembly(self, shape: float) -> tuple[FittedAssembly, float]:
        """Fit assembly errors of the prescription with a shape error to the planar captures, once.

        Also return the process time in seconds if another method spent it, else 0.
        """
        if shape in self._assemblies:
            return self._assemblies[shape]
        started = time.process_time()
        fitted = fit_assembly(self.planar, self.drawn(shape))
        self._assemblies[shape] = fitted, time.process_time() - started
        return fitted, 0.0


@dataclass(frozen=True)
class Rival:
    """A fitted method.

    Attributes:
        display, see_through: mappings of the method.
        numbers: number of numbers to be stored for both.
        shared_seconds: process time of a shared fit that was counted for another method.
    """

    display: DisplayMapping
    see_through: SeeThroughMapping
    numbers: int
    shared_seconds: float = 0.0


@dataclass(frozen=True)
class Method:
    """A method.

    Attributes:
        source: publication, or "this package".
        structure: "static", "volumetric", "planar", or another dependence on the eye's position.
        fit: function of captures that returns both mappings.
        lumps: True if it maps the world to pixels in one step; its mappings are meaningful only together.
    """

    source: str
    structure: str
    fit: Callable[[MethodData], Rival]
    lumps: bool = False


def _numbers(*mappings: Any) -> int:
    """Count the numbers stored by fitted models."""
    return sum(mapping.modelled.numbers for mapping in mappings)


def _kind(kind: str, data: MethodData) -> Rival:
    """Fit a model type of this package, by maximum evidence."""
    captures = data.of(kind)
    shown = fit_display(captures.both[0], kind).mapping
    seen = fit_see_through(captures.both[1], "static" if kind == "point-per-pixel" else kind).mapping
    return Rival(shown, seen, _numbers(shown, seen))


def _structured(fit: Fit, structure: str, data: MethodData) -> Rival:
    display, see_through = data.of(structure).both
    shown, pixels = fit_structure(DISPLAY, display, structure, fit)
    seen, directions = fit_structure(SEE_THROUGH, see_through, structure, fit)
    return Rival(shown, seen, pixels.numbers + directions.numbers)


def _pinhole(fit: Callable[[Captures], tuple[PinholeDisplay, FixedEyeSeeThrough]], data: MethodData) -> Rival:
    shown, seen = fit(data.planar)
    return Rival(shown, seen, shown.numbers)


def _screen(fit: Callable[[Captures], PinholeDisplay], data: MethodData) -> Rival:
    """Fit a flat virtual screen, with straight see-through rays."""
    shown = fit(data.planar)
    return Rival(shown, undeviated(shown.eye_box), shown.numbers)


def _point_table(data: MethodData) -> Rival:
    shown = klemm_grid(data.planar.both[0])
    seen = fit_see_through(data.planar.both[1], "static").mapping
    return Rival(shown, seen, _numbers(shown, seen))


def _distortion_field(data: MethodData) -> Rival:
    """Fit the field to the display; the see-through model is a static map."""
    display, see_through = data.volumetric.both
    shown = distortion_field(display, seconds=2.0 * _NETWORK_S)
    seen = fit_see_through(see_through, "static").mapping
    return Rival(shown, seen, shown.field.numbers + _numbers(seen))


def _plane_and_polynomial(bundled: bool, data: MethodData) -> Rival:
    display, see_through = data.of("planar" if bundled else "volumetric").both
    shown, pixels = wientapper_display(display, bundled=bundled)
    seen, directions = wientapper_see_through(see_through, bundled=bundled)
    return Rival(shown, seen, pixels.numbers + directions.numbers)


def _as_drawn(data: MethodData) -> Rival:
    return _traced(data.drawn(0.0))


def _traced(optics: Prescription) -> Rival:
    eye = TracedDisplay(optics, _WAVELENGTH_UM), TracedSeeThrough(optics, _WAVELENGTH_UM)
    return Rival(*eye, numbers=len(ASSEMBLY_NAMES))


def _fitted_prescription(shape: float, data: MethodData) -> Rival:
    assembly, seconds = data.assembly(shape)
    return replace(_traced(assembly.optics), shared_seconds=seconds)


def _grey_box(shape: float, data: MethodData) -> Rival:
    assembly, seconds = data.assembly(shape)
    mappings = fit_with_trends(data.planar, "grey-box", eye_trends(data.planar, assembly)).mappings
    return Rival(mappings.display, mappings.see_through, _numbers(mappings.display, mappings.see_through), seconds)


def _traced_components(fitted: bool, structure: str, data: MethodData) -> Rival:
    """Fit principal components to rays traced through a prescription, as drawn or with fitted assembly errors."""
    optics, seconds = data.drawn(SHAPE), 0.0
    if fitted:
        assembly, seconds = data.assembly(SHAPE)
        optics = assembly.optics
    setup, rng = data.bench_of(optics), np.random.default_rng(0)
    positions = setup.camera_positions(structure, TRACED_POSITIONS)
    traced = Captures(simulate_display(setup, positions, rng), simulate_see_through(setup, positions, rng))
    found = _structured(principal_components, structure, replace(data, planar=traced, volumetric=traced))
    return replace(found, shared_seconds=seconds)


_REGRESSORS: dict[str, tuple[str, Fit]] = {
    "linear-table": ("industry: US 10,373,297, US 10,241,545", linear_table),
    "thin-plate-table": ("industry, smoother", thin_plate_table),
    "components": ("Guan et al. 2022, black box", principal_components),
    "kernel-ridge": ("Itoh and Klinker 2015", kernel_ridge),
    "gaussian-process": ("Rasmussen and Williams 2006", gaussian_process),
    "network": ("Hiroi et al. 2022 without the sum along a ray", partial(network, seconds=_NETWORK_S)),
}


def _methods() -> dict[str, Method]:
    found = {name: Method("this package", name, partial(_kind, name)) for name in ("planar", "volumetric", "static")}
    for shape, end in ((0.0, ""), (SHAPE, "-misshapen")):
        found[f"grey-box{end}"] = Method("this package", "planar", partial(_grey_box, shape))
        source = "Guo et al. 2020"
        found[f"prescription-fitted{end}"] = Method(source, "ray tracing", partial(_fitted_prescription, shape))
    found["prescription-as-drawn"] = Method("Geng et al. 2018", "ray tracing", _as_drawn)
    found["point-per-pixel"] = Method("Klemm et al. 2017, smooth", "a point", partial(_kind, "point-per-pixel"))
    for name, (source, fit) in _REGRESSORS.items():
        for structure in STRUCTURES:
            found[f"{name}-{structure}"] = Method(source, structure, partial(_structured, fit, structure))
    free = partial(_structured, free_kernel_ridge, "planar")
    found["free-kernel-ridge-planar"] = Method("Itoh and Klinker 2015, freed", "planar", free)
    for fitted, structure in ((False, "volumetric"), (True, "planar")):
        end = "fitted" if fitted else "drawn"
        source = f"Guan et al. 2022, rays of the {end} prescription"
        fit_rays = partial(_traced_components, fitted, structure)
        found[f"traced-components-{end}"] = Method(source, structure, fit_rays)
    for structure in ("volumetric", "planar"):
        decode = partial(_structured, decoded_components, structure)
        found[f"decoded-components-{structure}"] = Method("OSTNet: Someya et al. 2019", structure, decode)
    found["distortion-field"] = Method("NDF: Hiroi et al. 2022", "volumetric", _distortion_field)
    offsets = partial(_structured, partial(offset_network, seconds=_NETWORK_S), "volumetric")
    found["offset-network"] = Method("HUDNet 2023; Yu et al. 2023", "volumetric", offsets)
    found["spaam"] = Method("Tuceryan and Navab 2000", "none", partial(_pinhole, spaam), lumps=True)
    found["spaam-redone"] = Method(
        "the same, redone at every position", "nearest", partial(_pinhole, spaam_redone), True
    )
    found["plane"] = Method(
        "DRC: Owen et al. 2004", "a flat screen", partial(_screen, lambda eye: direct_plane(eye.both[0]))
    )
    found["indica-full"] = Method(
        "Itoh and Klinker 2014", "a flat screen", partial(_screen, lambda eye: indica_full(eye.both[0]))
    )
    found["indica-recycle"] = Method("Itoh and Klinker 2014", "a flat screen", partial(_screen, indica_recycle))
    found["point-table"] = Method("Klemm et al. 2016", "a point", _point_table)
    for bundled, structure in ((False, "volumetric"), (True, "planar")):
        fit_plane = partial(_plane_and_polynomial, bundled)
        found[f"plane-and-polynomial-{structure}"] = Method("Wientapper et al. 2013", structure, fit_plane)
    return found


REGRESSORS = tuple(_REGRESSORS)
"""Names of regressors for every structure: "NAME-STRUCTURE" is a method."""
METHODS: Mapping[str, Method] = _methods()
"""Methods by name."""
