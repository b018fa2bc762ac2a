"""Model files: the fitted models of one or both eyes of a headset in one JSON text that needs no special reader.

    format "wlr-eye-model", version 3, package_version, frame "openxr", device
    units              {length "m", direction "tangent", pixel "px"}
    eyes               one or two of
        eye            "left" or "right"
         name           name of the model
        eye_box        {centre_m, size_m}
        display        {kind, panel {width_px, height_px}, base_plane {z_m, slope} (planar only), its polynomials, and
                       spread if the model has one}
        see_through    {kind, base_plane {z_m, slope} (planar only), its polynomials, and spread if the model has one}
        report         residuals that the calibration reported, in free form

display or see_through is omitted where it was not calibrated.

Version 1, of release 0.1, is still read. It has the keys of its single eye in the header, base planes without slope,
polynomials with the `degree` up to which they hold all terms, and no spread; it calls a display's `backward_start`
`backward`, and its see-through `backward` is not used.

`mapping_table.py` describes kinds, polynomials and spreads. Numbers are written so that they are read back exactly.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.html_summary import SummaryTable, html_summary
from wlr_render.io.file_records import record_keys
from wlr_render.io.input_files import as_bad_input
from wlr_render.io.toml_files import Table, read_json, write_json
from wlr_render.mappings import DisplayMapping, Eye, SeeThroughMapping
from wlr_render.models.absent import ABSENT_DISPLAY, ABSENT_SEE_THROUGH, Absent
from wlr_render.models.fitted_model import FittedModel
from wlr_render.models.mapping_table import mapping_kind, mapping_record, read_display, read_see_through
from wlr_render.models.plausible import plausible_eye_box

FORMAT = "wlr-eye-model"
VERSION = 3
_UNITS = {"length": "m", "direction": "tangent", "pixel": "px"}


@dataclass(frozen=True)
class EyeModel:
    """Fitted mappings of one eye, with the device name and the report of the fit.

    Attributes:
        mappings: display and see-through, each one of this package's models.
        device: device name.
        report: JSON-ready figures of the fit; stored, never interpreted.
    """

    mappings: Eye
    device: str
    report: Mapping[str, Any] = field(default_factory=dict)

    def _repr_html_(self) -> str:
        columns = ("fitted", "kind", "terms", "camera positions", "noise (arcmin)", "predicted error, rms (arcmin)")
        sides = {"display": self.mappings.display, "see_through": self.mappings.see_through}
        rows = [[name.replace("_", "-"), *self._fitted(name, mapping)] for name, mapping in sides.items()]
        fitted = SummaryTable(columns, rows)
        return html_summary(
            f"Model of {self.device}, {self.mappings.eye} eye: {self.mappings.name}",
            [],
            [self.mappings.summary, fitted],
        )

    def _fitted(self, name: str, mapping: object) -> list[str]:
        """Return the table cells of one mapping; a dash for each number that the report lacks."""
        kind = mapping_kind(mapping)
        if kind is None or not isinstance(mapping, FittedModel):
            return ["not calibrated", "-", "-", "-", "-"]
        terms, report = str(len(mapping.modelled.orders)), self.report.get(name)
        values = [report.get(key) if isinstance(report, Mapping) else None for key in _SHOWN]
        return [kind, terms, *(f"{each:.3g}" if isinstance(each, int | float) else "-" for each in values)]


_SHOWN = ("viewpoints", "noise_arcmin", "predicted_arcmin")  # keys of the report that a summary shows


def save_eye_models(path: str | Path, models: Sequence[EyeModel]) -> Path:
    """Write a model file atomically.

    Raises:
        BadInputError: two models of one eye or of two devices, a mapping that is not one of this package's models, or a
            folder that cannot be written.
    """
    by_eye = {model.mappings.eye: model for model in models}
    devices = {model.device for model in models}
    if len(by_eye) != len(models) or len(devices) != 1:
        raise BadInputError(f"{path}: a model file holds one model of each eye of one device; write one file each.")
    record = {
        "format": FORMAT,
        "version": VERSION,
        "package_version": metadata.version("wlr_render"),
        "frame": "openxr",
        "units": _UNITS,
        "device": devices.pop(),
        "eyes": [_eye_record(by_eye[eye]) for eye in sorted(by_eye)],
    }
    return write_json(path, record)


def add_eye_models(path: str | Path, models: Sequence[EyeModel]) -> tuple[str, ...]:
    """Add models to a file, keeping its models of other eyes of the same device; returns the eyes that were kept.

    Raises:
        BadInputError: see `save_eye_models`, and for an existing file `load_eye_models`.
    """
    new = {model.mappings.eye for model in models}
    present = load_eye_models(path) if Path(path).exists() else {}
    kept = [model for eye, model in present.items() if eye not in new and model.device == models[0].device]
    save_eye_models(path, [*kept, *models])
    return tuple(model.mappings.eye for model in kept)


def remove_eye_models(path: str | Path, eyes: Sequence[str]) -> None:
    """Remove the models of some eyes from a file; delete the file with its last model."""
    kept = [model for eye, model in load_eye_models(path).items() if eye not in eyes] if Path(path).exists() else []
    if kept:
        save_eye_models(path, kept)
    else:
        Path(path).unlink(missing_ok=True)


def load_eye_model(path: str | Path, eye: str | None = None) -> EyeModel:
    """Read one eye of a model file: the requested eye, or the only one.

    Raises:
        BadInputError: the file lacks that eye, or has both eyes and none was requested; see also `load_eye_models`.
    """
    models = load_eye_models(path)
    if eye is None and len(models) > 1:
        raise BadInputError(f"{path}: holds models of both eyes; say which one is meant: left or right.")
    if eye is not None and eye not in models:
        (only,) = models
        raise BadInputError(
            f"{path}: is a model of the {only} eye; the {eye} eye was asked for: calibrate it into the same folder, "
            f"or choose the {only} eye."
        )
    return models[eye or next(iter(models))]


def load_eye_models(path: str | Path) -> dict[str, EyeModel]:
    """Read a model file; returns its models by eye.

    Raises:
        BadInputError: the file cannot be read, is truncated, has another format or version, or lacks a key.
    """
    table = read_json(path, "a model file")
    version = _check_header(table)
    device = table.text("device")
    eyes = [table] if version == 1 else table.tables("eyes", most=2)
    models = [_eye_model(eye, device, version) for eye in eyes]
    for read in (table, *eyes):
        read.finish()
    by_eye = {model.mappings.eye: model for model in models}
    if not 1 <= len(by_eye) == len(models):
        present = ", ".join(model.mappings.eye for model in models) or "none"
        raise table.fail(f"'eyes' must hold one model, or one of each eye, not {present}; calibrate again.")
    return by_eye


def _eye_record(model: EyeModel) -> dict[str, Any]:
    eye = model.mappings
    record: dict[str, Any] = {
        "eye": eye.eye,
        "name": eye.name,
        "eye_box": record_keys(eye.eye_box),
    }
    if not isinstance(eye.display, Absent):
        record["display"] = mapping_record(eye.display)
    if not isinstance(eye.see_through, Absent):
        record["see_through"] = mapping_record(eye.see_through)
    return record | {"report": dict(model.report)}


def _eye_model(table: Table, device: str, version: int) -> EyeModel:
    eye_box = plausible_eye_box(table.table("eye_box"))
    display: DisplayMapping = ABSENT_DISPLAY
    see_through: SeeThroughMapping = ABSENT_SEE_THROUGH
    if table.has("display") or not table.has("see_through"):
        display = read_display(table.table("display"), eye_box, version)
    if table.has("see_through"):
        see_through = read_see_through(table.table("see_through"), eye_box, version)
    mappings = Eye(table.text("name"), table.text("eye", choices=["left", "right"]), display, see_through, eye_box)
    report = table.raw_table("report")
    with as_bad_input(f"{table.where}: 'report'", "plain JSON", "calibrate again"):
        json.dumps(report, allow_nan=False)  # refuses a report that could not be written again
    return EyeModel(mappings, device, report)


def _check_header(table: Table) -> int:
    """Check that a file is a model file; returns its version."""
    if table.text("format", default="missing") != FORMAT:
        raise table.fail(f"is not a model file: its format is not '{FORMAT}'; name one that calibration wrote.")
    version = table.check_head(FORMAT, VERSION, oldest=1, remedy="calibrate again")
    if version == 2:
        raise table.fail("has version 2, which no release wrote; calibrate again.")
    table.text("package_version")
    table.text("frame", choices=["openxr"])
    units = table.table("units")
    for quantity, unit in _UNITS.items():
        units.text(quantity, choices=[unit])
    units.finish()
    return version
