"""A headset as the user names it: a device (its exact optics) or a fitted model."""

from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeMappings, FloatArray
from wlr_render.models.model_file import load_eye_model
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye


def open_eye(spec: str | Path, eye: str = "right") -> EyeMappings:
    """Mappings of one eye: traced for a device name or .toml, fitted for a model .json.

    Raises:
        BadInputError: nothing of that name, a faulty file, or a model of the other eye.
    """
    if Path(spec).suffix != ".json":
        return traced_eye(load_device(spec), eye)
    mappings = load_eye_model(spec).mappings
    if mappings.eye != eye:
        raise BadInputError(f"{spec}: is a model of the {mappings.eye} eye; the {eye} eye was asked for.")
    return mappings


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
