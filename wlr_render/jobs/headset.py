"""A headset as the user names it: a device (its exact optics), a bench's device, or a file of fitted models."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from wlr_render.bench.bench_effects import optics_with_effects
from wlr_render.bench.bench_file import load_bench
from wlr_render.errors import BadInputError
from wlr_render.mappings import COLOURS, Eye, EyeChannels, middle_channel
from wlr_render.models.model_file import load_eye_model
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.combiner_form import SURFACES
from wlr_render.optics.device import Device
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.factory.factory_file import is_factory_file, load_factory_eyes
from wlr_render.optics.traced_mappings import traced_eye

PRIMARIES_UM = (0.6149, 0.5442, 0.4642)
"""Dominant wavelengths of the red, green and blue primaries of DCI-P3 (chromaticities: SMPTE RP 431-2), micrometres.

They stand for a panel's light by our choice; sRGB's primaries lie within 5 nm of them. A real primary is a band some
tens of nanometres wide, of which one map serves the middle.
"""


def is_model(spec: str | Path) -> bool:
    """Return whether a headset is named by its model file instead of a device or a factory calibration."""
    return _is_json(spec) and not is_factory_file(spec)


def is_factory(spec: str | Path) -> bool:
    """Return whether a headset is named by its factory calibration."""
    return _is_json(spec) and is_factory_file(spec)


def _is_json(spec: str | Path) -> bool:
    return Path(spec).suffix.lower() == ".json"


def headset_path(spec: str | Path) -> Path:
    """Return the path of the device file, model file or factory calibration of a headset.

    Raises:
        BadInputError: the device does not exist.
    """
    return Path(spec) if _is_json(spec) else device_path(spec)


def open_eye(spec: str | Path, eye: str = "right") -> Eye:
    """Return one eye of a headset, by exact optics, by fitted models or by its factory calibration.

    Args:
        spec: name of a shipped device or path of a device file (.toml), whose optics are traced in green light; a
            bench.toml, for its device with the heights that its effects add to the combiner; or path of a model file
            (.json), such as `Calibration.save` writes; or of a factory calibration (.json), green light.
        eye: "left" or "right".

    Returns:
        The mappings of display and world, and the eye box; device frame, metres.

    Raises:
        BadInputError: there is nothing of that name, the file is faulty, or it does not have this eye.

    Example:
        >>> import wlr_render as wlr
        >>> wlr.open_eye("northstar", "left").eye_box.size
        array([0.01 , 0.008, 0.006])
    """
    if is_factory(spec):
        return middle_channel(load_factory_eyes(spec, eye))
    if not is_model(spec):
        return traced_eye(_device(spec), eye)
    return load_eye_model(spec, eye).mappings


def _device(spec: str | Path) -> Device:
    """Return a device; for a bench, its device with the heights that its effects add to the combiner."""
    if Path(spec).name != "bench.toml":
        return load_device(spec)
    bench = load_bench(spec)
    return replace(
        bench.device, eyes={**bench.device.eyes, bench.eye: optics_with_effects(bench.optics, bench.effects)}
    )


def effect_warnings(spec: str | Path) -> list[str]:
    """Return a sentence on the effects of a bench's headset that its maps leave out, if any."""
    if Path(spec).name != "bench.toml":
        return []
    of_headset = [each for each in load_bench(spec).effects if each.station in ("panel", "combiner")]
    left_out = sorted({f"{each.station} ({each.displaces})" for each in of_headset if each.displaces not in SURFACES})
    if not left_out:
        return []
    return [
        f"{spec}: the maps do not have its effects of {', '.join(left_out)}; render with models fitted to the session "
        "(`calibrate`), which absorb them."
    ]


def open_channels(
    spec: str | Path,
    eyes: Iterable[str],
    per_colour: bool,
    red_model: Path | None = None,
    blue_model: Path | None = None,
) -> dict[str, EyeChannels]:
    """Open the mappings of some eyes with `open_colours` if `per_colour`, else with `open_eye`.

    Raises:
        BadInputError: as `open_colours` and `open_eye`.
    """
    if per_colour:
        return {eye: open_colours(spec, eye, red_model, blue_model) for eye in eyes}
    return {eye: (open_eye(spec, eye),) for eye in eyes}


def open_colours(
    spec: str | Path, eye: str = "right", red_model: Path | None = None, blue_model: Path | None = None
) -> EyeChannels:
    """Open the mappings of one eye in red, green and blue light.

    Args:
        spec: a device, which is traced at `PRIMARIES_UM`, a factory calibration, or the file of the models fitted in
            green light.
        eye: "left" or "right".
        red_model, blue_model: files of the models fitted in red and blue light, if `spec` is a model file.

    Raises:
        BadInputError: as `open_eye`; a device with models, a model without them, or models that differ in panel or eye
            box.
    """
    if not is_model(spec):
        if red_model or blue_model:
            raise BadInputError(
                f"{spec}: is a device, which is traced in all colours; give --per-colour without models, or name the "
                "model in green light with --red-model and --blue-model."
            )
        if is_factory(spec):
            found = load_factory_eyes(spec, eye)
            return found if len(found) > 1 else found * len(COLOURS)
        device = _device(spec)
        return tuple(traced_eye(device, eye, wavelength_um) for wavelength_um in PRIMARIES_UM)
    if red_model is None or blue_model is None:
        raise BadInputError(
            f"{spec}: is a model of one colour; give --red-model and --blue-model as well, and {spec} for green."
        )
    green = open_eye(spec, eye)
    return _same_eye(green, red_model), green, _same_eye(green, blue_model)


def _same_eye(green: Eye, spec: Path) -> Eye:
    other = open_eye(spec, green.eye)
    first, second = (np.stack([mappings.eye_box.centre, mappings.eye_box.size]) for mappings in (green, other))
    if green.display.panel != other.display.panel or not np.allclose(first, second, rtol=0, atol=1e-9):
        raise BadInputError(
            f"{spec}: has another panel or eye box than the green model; fit all three colours to one calibration."
        )
    return other


def require_in_eye_box(mappings: Eye, viewpoint: FloatArray, where: str) -> None:
    """Refuse a viewpoint (3,) outside the eye box of the mappings.

    Raises:
        BadInputError: it lies outside the eye box; the message states both.
    """
    box = mappings.eye_box
    if not box.contains(viewpoint, margin=1e-6):
        low, high = (box.centre - box.size / 2) * 1e3, (box.centre + box.size / 2) * 1e3
        at, low_text, high_text = (", ".join(f"{x:.2f}" for x in v) for v in (viewpoint * 1e3, low, high))
        raise BadInputError(
            f"{where}: the viewpoint ({at}) mm lies outside the eye box of {mappings.name}, ({low_text}) to "
            f"({high_text}) mm in the device frame; correct the eye position, or enlarge the eye box in the device file"
            " or in the captures that the model is fitted to."
        )
