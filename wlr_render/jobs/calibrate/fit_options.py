"""Shared parts of the calibrate verbs: options of the fit, and the model file."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

from wlr_render.calibration.fit_eye import KINDS_BY_PRESCRIPTION, Calibration, KindComparison, fit_eye, fit_kinds
from wlr_render.captures.correspondences import EyeCaptures
from wlr_render.captures.photo_session import CHANNELS
from wlr_render.errors import BadInputError
from wlr_render.jobs.options import Degree, Options, described, flag_of
from wlr_render.models.model_file import add_eye_models, load_eye_models, remove_eye_models
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.device_file import device_path, load_device

MODEL_FILE = "model.json"
MODELS_OF_PRIMARIES = {name: f"model-{name}.json" for name in CHANNELS}
"""Model files of single primaries of the display, by their names."""
RESULTS = (("captures", ".npz"), ("station", ".json"))
"""Kinds and suffixes of the files KIND-EYE of a calibration from photographs."""


@dataclass(frozen=True)
class FitOptions(Options):
    """Options of the fit, which every `calibrate` verb has."""

    _: KW_ONLY
    kind: Annotated[
        Literal["planar", "volumetric", "static", "point-per-pixel", "grey-box", "prescription"] | None,
        described(
            "Model type (default: planar; with a prescription the most probable of planar, grey-box and prescription)."
        ),
    ] = None
    degree: Annotated[
        int | None,
        described(
            "Highest total degree of the display model (default: all terms that the captures lead to expect; at most "
            "12 in the pixel and in all, 6 in the place)."
        ),
        Degree,
    ] = None
    see_through_degree: Annotated[
        int | None,
        described(
            "Highest total degree of the see-through model (default: all terms that the captures lead to expect; at "
            "most 12 in the direction and in all, 6 in the place)."
        ),
        Degree,
    ] = None
    prescription: Annotated[
        str | None,
        described("Prescription of the headset, whose assembly errors are fitted: a shipped device or a device file."),
    ] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.prescription is None and self.kind in KINDS_BY_PRESCRIPTION:
            raise BadInputError(
                f"{flag_of(type(self), 'kind')} {self.kind} needs {flag_of(type(self), 'prescription')} DEVICE: a "
                "shipped device or a device file."
            )
        if self.prescription is not None and self.kind not in (None, *KINDS_BY_PRESCRIPTION):
            raise BadInputError(
                f"{flag_of(type(self), 'prescription')} is not used by a {self.kind} model; leave it out, or leave out "
                f"{flag_of(type(self), 'kind')}."
            )

    @property
    def inputs(self) -> list[Path]:
        """The device file of the prescription, if any."""
        return [] if self.prescription is None else [device_path(self.prescription)]

    def prescription_of(self, eye: str) -> EyeOptics | None:
        """The prescription of an eye, if one is named; long jobs read it first.

        Raises:
            BadInputError: it cannot be read, or has no such eye.
        """
        if self.prescription is None:
            return None
        device = load_device(self.prescription)
        if eye not in device.eyes:
            raise BadInputError(
                f"{flag_of(type(self), 'prescription')} {self.prescription}: has no {eye} eye, of which the captures "
                "are; name the headset that was measured."
            )
        return device.eyes[eye]

    def fit(self, captures: EyeCaptures) -> KindComparison:
        """Fit the models of one eye: of one kind, or of all that a prescription allows.

        Raises:
            BadInputError: the captures do not determine a model, or the prescription has no such eye or does not fit.
        """
        limits = self.degree, self.see_through_degree
        prescription = self.prescription_of(captures.source.eye)
        if prescription is None:
            kind = self.kind or "planar"
            return KindComparison({kind: fit_eye(captures, kind, *limits)}, kind)
        if self.kind is None:
            return fit_kinds(captures, prescription, *limits)
        return KindComparison({self.kind: fit_eye(captures, self.kind, *limits, prescription=prescription)}, self.kind)


DEFAULT_FIT = FitOptions()
OutputFolder = Annotated[
    Path, described("Output folder. If its model.json holds the other eye of the same device, that eye stays.")
]


def require_readable_models(folder: Path, name: str = MODEL_FILE) -> None:
    """Refuse a folder whose model file is damaged, before work begins: the other eye's model may be saved from it."""
    path = folder / name
    if path.exists():
        try:
            load_eye_models(path)
        except BadInputError as error:
            raise BadInputError(
                f"{path}: cannot be added to ({error}); move it away, or choose another output folder."
            ) from error


def save_models(folder: Path, fits: Sequence[Calibration], name: str = MODEL_FILE) -> tuple[Path, tuple[str, ...]]:
    """Write a model file; returns its path, and sentences about what was in it before."""
    path = folder / name
    before = {model.device for model in load_eye_models(path).values()} if path.exists() else set()
    kept = add_eye_models(path, [fit.model() for fit in fits])
    notes = [f"{path} also holds the {eye} eye, from an earlier run." for eye in kept]
    notes += [f"{path} held models of {device}; they were replaced." for device in before - {fits[0].device}]
    return path, tuple(notes)


def remove_results(folder: Path, eyes: Sequence[str], keep_captures: bool = False) -> None:
    """Remove what an earlier calibration wrote beside the models of some eyes: it does not belong to new models.

    With `keep_captures`, the files of `RESULTS` stay: the new models are of these captures.

    Raises:
        BadInputError: a model file of a primary is damaged.
    """
    for name in MODELS_OF_PRIMARIES.values():
        require_readable_models(folder, name)
    for name in MODELS_OF_PRIMARIES.values():
        remove_eye_models(folder / name, eyes)
    names = [] if keep_captures else [f"{kind}-{eye}{suffix}" for eye in eyes for kind, suffix in RESULTS]
    for name in (*names, "coverage.png", "decoding.png", *(f"coverage-{eye}.png" for eye in eyes)):
        (folder / name).unlink(missing_ok=True)
