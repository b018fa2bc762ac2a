"""User-defined causes, and the choice of causes for a diagnosis."""

import importlib
import importlib.util
import sys
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import fields, is_dataclass, replace
from importlib.machinery import SourceFileLoader
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from wlr_render.bench.bench import Bench
from wlr_render.bench.bench_effects import AnyFunction, BenchEffect
from wlr_render.diagnosis.cause import PARTS, Cause, Perturb, Role, unknown_cause, with_priors
from wlr_render.diagnosis.causes import CAUSES
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents
from wlr_render.io.input_files import read_text, reason_of, shown
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.traced_mappings import TracedDisplay, TracedSeeThrough

ENTRY_POINTS = "wlr_render.causes"
"""Entry point group through which an installed package adds causes: each names a `CAUSES`, an iterable of `Cause`."""
_PLACES = 50  # number of places at a station where the effects of two benches are compared
_MOST_MISS = 0.05  # largest error of a function's polynomial in a file, relative to the function's largest value


def causes_for(
    bench: Bench, added: Sequence[str] = (), only: Sequence[str] = (), excluded: Sequence[str] = ()
) -> dict[str, Cause]:
    """Return the causes, by name, for the diagnosis of a bench, with the priors that the bench states.

    Args:
        bench: the nominal bench.
        added: Python files (`.py`) or modules that define `CAUSES`, an iterable of `Cause`; they join the listed causes
            and the causes of installed packages.
        only: names of the causes to consider; all if empty.
        excluded: names of the causes to leave out.

    Raises:
        BadInputError: a file or module cannot be loaded or defines no causes, a cause fails on this bench, a name is
            taken or unknown, or no cause is left.
    """
    causes = dict(CAUSES)
    for where, stated in (*_installed(), *((each, _loaded(each)) for each in added)):
        for cause in _checked(where, stated, bench):
            if cause.name in causes:
                raise BadInputError(f"{where}: there is a cause '{cause.name}' already; choose another name.")
            causes[cause.name] = cause
    causes = with_priors(causes, bench.priors)
    for name in (*only, *excluded):
        if name not in causes:
            raise BadInputError(unknown_cause(name, causes))
    chosen = {name: cause for name, cause in causes.items() if name not in excluded and (not only or name in only)}
    if not chosen:
        raise BadInputError("Every cause is excluded; leave one or more to be considered.")
    return chosen


def _installed() -> list[tuple[str, Any]]:
    """Return the entry points of installed packages that state causes, and these causes."""
    found = []
    for entry in entry_points(group=ENTRY_POINTS):
        where = f"entry point '{entry.name}' ({entry.value})"
        try:
            found.append((where, entry.load()))
        except Exception as error:
            raise _failed(where, error) from error
    return found


def _loaded(source: str) -> Any:
    """Return `CAUSES` of a Python file or of a module."""
    try:
        module = _module_of_file(Path(source)) if source.endswith(".py") else importlib.import_module(source)
    except (BadInputError, KeyboardInterrupt):
        raise
    except BaseException as error:  # a module may raise SystemExit or its own exceptions
        raise _failed(source, error) from error
    if not hasattr(module, "CAUSES"):
        raise BadInputError(f"{source}: defines no CAUSES; add CAUSES = (Cause(...),) as docs/diagnosis.md shows.")
    return module.CAUSES


def _module_of_file(path: Path) -> Any:
    read_text(path, "Python", remedy="name a Python file that defines CAUSES")  # refuses pipes and endless files
    name = f"wlr_render_causes_of_{path.stem}"
    loader = SourceFileLoader(name, str(path))
    spec = importlib.util.spec_from_file_location(name, path, loader=loader)
    assert spec is not None, "the name ends in .py"
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look up their module
    # The usual import would write bytecode to the user's folder, and reuse it after a quick edit of the same length.
    exec(loader.source_to_code(path.read_bytes(), str(path)), module.__dict__)
    return module


def _failed(where: str, error: BaseException) -> BadInputError:
    return BadInputError(
        f"{where}: cannot be loaded ({type(error).__name__}: {reason_of(error)}); import it in Python to see where."
    )


def _checked(where: str, stated: Any, bench: Bench) -> list[Cause]:
    """Return the causes that a source states; raise BadInputError if one does not work on the bench."""
    if not isinstance(stated, Iterable) or isinstance(stated, str | Mapping):
        raise BadInputError(f"{where}: CAUSES is {shown(stated)}; it must be a tuple or list of Cause.")
    causes = list(stated)
    for cause in causes:
        if not isinstance(cause, Cause):
            raise BadInputError(
                f"{where}: CAUSES holds {shown(cause)}, which is not a wlr_render.diagnosis.cause.Cause."
            )
        fault = _fault(cause, bench)
        if fault:
            raise BadInputError(f"{where}: cause '{cause.name}' {fault}.")
    return [replace(cause, variants={name: _refusing(cause, name) for name in cause.variants}) for cause in causes]


def _refusing(cause: Cause, variant: str) -> Perturb:
    """Return a variant that raises BadInputError where its function fails: a fit then takes a shorter step."""

    def perturb(bench: Bench, values: FloatArray) -> Bench:
        try:
            return cause.perturb(bench, values, variant)
        except Exception as error:
            raise BadInputError(f"cause '{cause.name}' {_failure(variant, error)}.") from error

    return perturb


def _failure(variant: str, error: Exception) -> str:
    return f"fails in its variant '{variant}' ({type(error).__name__}: {reason_of(error)})"


def _fault(cause: Cause, bench: Bench) -> str:
    """Return the fault of a cause, phrased to follow its name; empty for a valid cause."""
    if cause.part not in PARTS:
        return f"has the part {cause.part!r}; choose from {', '.join(PARTS)}"
    if not cause.variants:
        return "has no variants; give one function of (bench, values)"
    if not any(parameter.role is Role.SIZE for parameter in cause.parameters):
        return "has no parameter with the role SIZE, so that there is nothing to fit"
    for parameter in cause.parameters:
        if not 0.0 < parameter.prior_sigma < np.inf:
            return f"has a prior_sigma of {parameter.prior_sigma} for '{parameter.name}'; it must be finite and above 0"
    given = deepcopy(bench)  # shows whether a function changes the bench in place
    sizes = np.array([0.1 * p.prior_sigma if p.role is Role.SIZE else 0.0 for p in cause.parameters])
    for variant in cause.variants:
        try:
            returned: list[Any] = [cause.perturb(bench, cause.null() + by, variant) for by in (sizes, 0.0 * sizes)]
        except Exception as error:
            return _failure(variant, error)
        fault = _fault_of(returned, given, variant, cause.null())
        if fault:
            return fault
    return ""


def _fault_of(returned: Sequence[Any], given: Bench, variant: str, null: FloatArray) -> str:
    """Return the fault of a variant's benches for small values and for its null values; empty without a fault."""
    for each in returned:
        if not isinstance(each, Bench):
            return f"returns {type(each).__name__} in its variant '{variant}'; it must return a Bench"
    for effect in returned[0].effects:
        if (miss := _miss_in_file(effect)) > _MOST_MISS:
            return (
                f"displaces the {effect.station} by a function that a corrected bench.toml cannot state (its "
                f"polynomial misses it by {100 * miss:.0f} %); give a smoother function or closer bounds"
            )
    where = _difference(given, returned[1])
    if not where:
        return ""
    return (
        f"changes {where} in its variant '{variant}' at its null values {null.tolist()}; there it must "
        "return the same bench, and it must never change the given one in place"
    )


def _difference(given: Bench, returned: Bench) -> str:
    """Return the first attribute in which two benches differ, e.g. `camera.focal_px`; empty if none differs.

    Headsets are compared by their rays, because a cause may add surfaces that have no effect.
    """
    if given.eye != returned.eye:
        return "eye"
    if not _same_numbers(_rays(given.optics, given.wavelengths_um), _rays(returned.optics, given.wavelengths_um)):
        return "device"
    for field in fields(Bench):
        old, new = getattr(given, field.name), getattr(returned, field.name)
        if field.name in ("device", "eye", "priors"):
            continue
        if field.name == "effects":
            old, new = ([each for effect in effects for each in _displaced(effect)] for effects in (old, new))
        names = [each.name for each in fields(old)] if is_dataclass(old) else []
        for name in names:
            if not _same_numbers(getattr(old, name), getattr(new, name)):
                return f"{field.name}.{name}"
        if not names and not _same_numbers(old, new):
            return field.name
    return ""


def _displaced(effect: BenchEffect) -> list[FloatArray]:
    """Return the displacements of an effect at sample places, or its coefficients; empty if all are zero."""
    function = effect.function
    values = function(function.box.places(_PLACES)) if isinstance(function, AnyFunction) else function.coefficients
    return [values] if np.any(values) else []


def _miss_in_file(effect: BenchEffect) -> float:
    """Return the largest error of the polynomial that states a function in a file, relative to its largest value."""
    if not isinstance(effect.function, AnyFunction):
        return 0.0
    places = effect.function.box.places(_PLACES)
    values = effect.function(places)
    stated = effect.function.as_polynomial()(places)
    return float(np.abs(stated - values).max() / max(np.abs(values).max(), np.finfo(float).tiny))


def _rays(optics: EyeOptics, wavelengths_um: Sequence[float]) -> FloatArray:
    """Return panel pixels and world rays (n, 6) over the field, from the middle and the corners of the eye box."""
    tangents = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, 5)] * 2), axis=-1).reshape(-1, 2)
    box = optics.eye_box
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 1, 3)
    viewpoint = np.concatenate([box.at(np.zeros((1, 1, 3))), box.at(corners)])
    direction = np.broadcast_to(dir_of_tangents(tangents), (len(viewpoint), len(tangents), 3))
    viewpoint = np.broadcast_to(viewpoint, direction.shape)
    found = [
        np.concatenate(
            [
                TracedDisplay(optics, wavelength).plane_pixel(direction, viewpoint)[0],
                TracedSeeThrough(optics, wavelength).real_ray_of_view_dir(direction, viewpoint).value,
            ],
            axis=-1,
        )
        for wavelength in wavelengths_um
    ]
    return np.stack(found)


def _same_numbers(old: Any, new: Any) -> bool:
    try:
        return bool(np.allclose(old, new, rtol=1e-9, atol=1e-12, equal_nan=True))
    except (TypeError, ValueError):  # not numbers, or arrays of different shapes
        return False
