"""Options of `calibrate`, and the model file that it writes."""

import dataclasses
import typing
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

from wlr_render.calibration.fit_alignments import AlignmentFit
from wlr_render.calibration.fit_eye import KINDS_BY_PRESCRIPTION, Calibration, KindComparison, calibrate, fit_kinds
from wlr_render.calibration.validation import require_testable
from wlr_render.captures.alignments_file import is_alignments
from wlr_render.captures.correspondences import Captures
from wlr_render.captures.photo_session import CHANNELS
from wlr_render.captures.photo_session_file import FILE as PHOTO_SESSION
from wlr_render.errors import BadInputError
from wlr_render.jobs import limits
from wlr_render.jobs.headset import is_model
from wlr_render.jobs.options import (
    SEEDS,
    WORKERS,
    Against,
    Degree,
    Eyes,
    Options,
    SpreadOptions,
    described,
    flag_of,
    option_group,
)
from wlr_render.models.model_file import add_eye_models, load_eye_models, remove_eye_models
from wlr_render.optics.device import EyeOptics
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.usual import CAMERA_NOISE_ARCMIN

MODEL_FILE = "model.json"
MODELS_OF_PRIMARIES = {name: f"model-{name}.json" for name in CHANNELS}
"""Model files of single primaries of the display, by their names."""
RESULTS = (("captures", ".npz"), ("station", ".json"))
"""Kinds and suffixes of the files KIND-EYE of a calibration from photographs."""


_FIT = option_group("Fit", 1)
_PHOTOGRAPHS = option_group("Session of photographs, or --validate", 2)
_BENCH = option_group("Bench session", 3)
_DEVICE = option_group("Simulated captures (only if PATH is a device)", 4)


@dataclass(frozen=True)
class FitOptions(Options):
    """Options of the fit."""

    _: KW_ONLY
    kind: Annotated[
        Literal["planar", "volumetric", "static", "point-per-pixel", "grey-box", "prescription"] | None,
        described(
            "Model type (default: planar; with --prescription the most probable of planar, grey-box and prescription).",
            group=_FIT,
        ),
    ] = None
    degree: Annotated[
        int | None,
        described(
            "Highest total degree of the display model (default: chosen from the captures, at most 12 in total and "
            "in the pixel, 6 in the camera position).",
            group=_FIT,
        ),
        Degree,
    ] = None
    see_through_degree: Annotated[
        int | None,
        described(
            "Highest total degree of the see-through model (default: chosen from the captures, at most 12 in total "
            "and in the direction, 6 in the camera position).",
            group=_FIT,
        ),
        Degree,
    ] = None
    prescription: Annotated[
        str | None,
        described(
            "Optical prescription of the headset (a shipped device or a device file); its assembly errors are fitted.",
            group=_FIT,
        ),
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
        """Return the prescription of an eye, if one is given. Long jobs call this first to fail early.

        Raises:
            BadInputError: the prescription cannot be read, or has no such eye.
        """
        if self.prescription is None:
            return None
        device = load_device(self.prescription)
        if eye not in device.eyes:
            raise BadInputError(
                f"{flag_of(type(self), 'prescription')} {self.prescription}: has no {eye} eye, but the captures are "
                "of it; name the headset that was measured."
            )
        return device.eyes[eye]

    def fit(self, captures: Captures) -> KindComparison:
        """Fit the models of one eye: of one kind, or of all that a prescription allows.

        Raises:
            BadInputError: the captures do not determine a model, or the prescription has no such eye or does not fit.
        """
        limits = self.degree, self.see_through_degree
        prescription = self.prescription_of(captures.source.eye)
        if prescription is None:
            kind = self.kind or "planar"
            return KindComparison({kind: calibrate(captures, kind, *limits)}, kind)
        if self.kind is None:
            return fit_kinds(captures, prescription, *limits)
        return KindComparison(
            {self.kind: calibrate(captures, self.kind, *limits, prescription=prescription)}, self.kind
        )


DEFAULT_FIT = FitOptions()


class Subject(StrEnum):
    """Kind of input of a calibration."""

    PHOTOGRAPHS = "a session of photographs"
    BENCH = "a bench session"
    CAPTURES = "a capture file"
    ALIGNMENTS = "a file of alignments"
    DEVICE = "a device"


_GROUPS = {Subject.PHOTOGRAPHS: _PHOTOGRAPHS, Subject.BENCH: _BENCH, Subject.DEVICE: _DEVICE}
"""Groups of the options that have an effect on one subject only."""
_SUBJECTS = "a folder of a session, a capture file (.npz), alignments (.toml), or a device (name or .toml)"


@dataclass(frozen=True)
class CalibrateOptions(SpreadOptions):
    """Options of `calibrate`."""

    path: Annotated[
        str,
        described(
            "Folder of a session of photographs or of a bench session, capture file (.npz), a wearer's alignments "
            "(.toml, docs/files.md), or device (name or .toml)."
        ),
    ]
    _: KW_ONLY
    out: Annotated[
        Path, described("Output folder. If its model.json holds the other eye of the same device, that eye stays.")
    ] = Path("out/calibrate")
    against: Against = None
    fit: FitOptions = DEFAULT_FIT
    validate: Annotated[
        bool,
        described(
            "Test the stated errors by some thirty refits, to drawn noise and to parts of the camera positions; an "
            "interrupted run continues.",
            flag=True,
        ),
    ] = False
    workers: Annotated[
        int | None,
        described(
            "Number of processes that read the photographs, and that refit (default: one per core, fewer where memory "
            "limits).",
            group=_PHOTOGRAPHS,
        ),
        WORKERS,
    ] = None
    scheduler: Annotated[
        str | None,
        described("Address of a Dask scheduler, whose workers do both (docs/clusters.md).", group=_PHOTOGRAPHS),
    ] = None
    bench: Annotated[
        Path | None,
        described(
            "Bench file to read the session with, e.g. the corrected one (default: the session's own).", group=_BENCH
        ),
    ] = None
    eye: Annotated[Eyes, described("Eyes to calibrate.", group=_DEVICE)] = "right"
    viewpoints: Annotated[int, described("Number of camera positions.", group=_DEVICE), limits.PLACES] = 25
    noise_arcmin: Annotated[
        float,
        described("Noise of a direction in arcmin, standard deviation per axis.", group=_DEVICE),
        limits.ANGLE_ARCMIN,
    ] = CAMERA_NOISE_ARCMIN.value
    repeatability_um: Annotated[
        float,
        described("Repeatability of the stage in um, standard deviation per axis.", group=_DEVICE),
        limits.REPEATABILITY_UM,
    ] = 0.0
    turn_jitter_urad: Annotated[
        float,
        described("Random camera rotation at each stop in urad, standard deviation per axis.", group=_DEVICE),
        limits.ROTATION_URAD,
    ] = 0.0
    seed: Annotated[int, described("Seed of all random numbers.", group=_DEVICE), SEEDS] = 1

    def fit_of(self, captures: Captures) -> KindComparison:
        """Fit according to the options `fit`.

        Raises:
            BadInputError: as `FitOptions.fit`, or `--validate` cannot test the fit.
        """
        if self.validate:
            require_testable(captures)
        return self.fit.fit(captures)

    @property
    def subject(self) -> Subject:
        """Kind of input at `path`.

        Raises:
            BadInputError: a folder without a session, or a model file.
        """
        path = Path(self.path)
        if not path.is_dir():
            if is_model(path):
                raise BadInputError(f"{path}: is a fitted model; name {_SUBJECTS}.")
            if is_alignments(path):
                return Subject.ALIGNMENTS
            return Subject.CAPTURES if path.suffix.lower() == ".npz" else Subject.DEVICE
        for name, subject in ((PHOTO_SESSION, Subject.PHOTOGRAPHS), ("bench.toml", Subject.BENCH)):
            if (path / name).exists():
                return subject
        raise BadInputError(
            f"{path}: has no {PHOTO_SESSION}, so it is not a session of photographs, and no bench.toml, so it is not "
            f"a bench session; name {_SUBJECTS}."
        )

    def require_for(self, subject: Subject) -> None:
        """Reject options that do not apply to this kind of input.

        Raises:
            BadInputError: an option has no effect on this kind of input.
        """
        if subject is Subject.ALIGNMENTS and (self.fit != DEFAULT_FIT or self.validate):
            raise BadInputError(
                f"--validate and the options of the fit are not used with {subject}, and {self.path} is one; leave "
                "them out."
            )
        hints = typing.get_type_hints(type(self), include_extras=True)
        for field in dataclasses.fields(self):
            groups = [note.group for note in getattr(hints[field.name], "__metadata__", ()) if hasattr(note, "group")]
            applies = next((each for each, group in _GROUPS.items() if any(group in some for some in groups)), subject)
            if self.validate and applies is Subject.PHOTOGRAPHS:
                continue  # --workers also spreads the refits
            if applies is not subject and getattr(self, field.name) != field.default:
                raise BadInputError(
                    f"{flag_of(type(self), field.name)} is used with {applies} only, and {self.path} is {subject}; "
                    "leave it out."
                )


def require_readable_models(folder: Path, name: str = MODEL_FILE) -> None:
    """Refuse a folder with a damaged model file before work begins; the file may contain the other eye's model."""
    path = folder / name
    if path.exists():
        try:
            load_eye_models(path)
        except BadInputError as error:
            raise BadInputError(
                f"{path}: cannot be added to ({error}); move it away, or choose another output folder."
            ) from error


def save_models(
    folder: Path, fits: Sequence[Calibration | AlignmentFit], name: str = MODEL_FILE
) -> tuple[Path, tuple[str, ...]]:
    """Write a model file; return its path, and sentences about its previous content."""
    path = folder / name
    before = {model.device for model in load_eye_models(path).values()} if path.exists() else set()
    kept = add_eye_models(path, [fit.model() for fit in fits])
    notes = [f"{path} also holds the {eye} eye, from an earlier run." for eye in kept]
    notes += [f"{path} held models of {device}; they were replaced." for device in before - {fits[0].device}]
    return path, tuple(notes)


def remove_results(folder: Path, eyes: Sequence[str], keep_captures: bool = False) -> None:
    """Remove the files of an earlier calibration of some eyes, except the models: they do not match the new models.

    With `keep_captures`, the files of `RESULTS` stay, because the new models are fitted to these captures.

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
