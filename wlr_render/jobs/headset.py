"""A headset as the user names it: a device (its exact optics) or a fitted model."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeMappings
from wlr_render.models.model_file import load_eye_model
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye

PRIMARIES_UM = (0.6149, 0.5442, 0.4642)
"""Dominant wavelengths of the red, green and blue primaries of DCI-P3 (chromaticities: SMPTE RP 431-2), micrometres.

They stand for a panel's light by our choice; sRGB's primaries lie within 5 nm of them. A real primary is a band some
tens of nanometres wide, of which one map serves the middle.
"""

RgbMappings = tuple[EyeMappings, EyeMappings, EyeMappings]
"""One eye in red, green and blue light, with one panel and one eye box."""


def open_eye(spec: str | Path, eye: str = "right") -> EyeMappings:
    """Mappings of one eye: traced for a device name or .toml, fitted for a model .json.

    Raises:
        BadInputError: nothing of that name, a faulty file, or a model of the other eye.
    """
    if Path(spec).suffix != ".json":
        return traced_eye(load_device(spec), eye)
    return load_eye_model(spec, eye).mappings


def open_channels(specs: Sequence[str | Path], eye: str = "right") -> RgbMappings:
    """Mappings of one eye for each colour of its panel.

    Args:
        specs: one device, which is traced at `PRIMARIES_UM`, or three model files, for red, green and blue.
        eye: "left" or "right".

    Raises:
        BadInputError: as `open_eye`, or another number of files, or models that differ in panel or eye box.
    """
    if len(specs) == 1 and Path(specs[0]).suffix != ".json":
        device = load_device(specs[0])
        red, green, blue = (traced_eye(device, eye, wavelength_um) for wavelength_um in PRIMARIES_UM)
    elif len(specs) == 3:
        red, green, blue = (open_eye(spec, eye) for spec in specs)
    else:
        raise BadInputError(
            f"{', '.join(map(str, specs)) or 'no headset'}: give one device, or three model files that were fitted in "
            "red, green and blue light."
        )
    for other, spec in ((red, specs[0]), (blue, specs[-1])):
        _require_same_eye(green, other, spec)
    return red, green, blue


def _require_same_eye(green: EyeMappings, other: EyeMappings, spec: str | Path) -> None:
    first, second = (np.stack([mappings.eye_box.centre, mappings.eye_box.size]) for mappings in (green, other))
    if green.display.panel != other.display.panel or not np.allclose(first, second, rtol=0, atol=1e-9):
        raise BadInputError(
            f"{spec}: has another panel or eye box than the green model; fit all three colours to one calibration."
        )


def require_in_eye_box(mappings: EyeMappings, viewpoint: FloatArray, where: str) -> None:
    """Refuse a viewpoint (3,) that the mappings were not made for.

    Raises:
        BadInputError: it lies outside the eye box; the sentence has both.
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
