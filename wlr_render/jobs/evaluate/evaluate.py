"""Evaluate devices in simulation: model errors, and the number of camera positions that calibration needs."""

from dataclasses import asdict

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.files import output_folder
from wlr_render.jobs.evaluate.experiments import EXPERIMENTS, box_text
from wlr_render.jobs.evaluate.study import EvaluateOptions, Study
from wlr_render.jobs.evaluate.trials import (
    TEST_RAYS,
    TEST_VIEWPOINTS,
    AnyTrial,
    EvaluatedEye,
    Outcome,
    run_trials,
    truth,
)
from wlr_render.jobs.options import ProgressArgument, eyes_of
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.progress import SILENT
from wlr_render.report.blocks import Block, Cell, Report, ReportTable, Section, Text
from wlr_render.report.save import save_report

_DEFAULTS = EvaluateOptions()


def evaluate(options: EvaluateOptions = _DEFAULTS, *, progress: ProgressArgument = SILENT) -> Report:
    """Evaluate devices in simulation by the chosen experiments; trials that several of them need run once.

    Raises:
        BadInputError: no device, degree, count or experiment, a faulty device, an eye that it does not have, or a
            folder that cannot be written.
    """
    for name in ("device", "experiment", "degrees", "counts"):
        if not getattr(options, name):
            raise BadInputError(f"{name} is empty; give at least one.")
    eyes = _evaluated_eyes(options)
    folder = output_folder(options.out)
    chosen = {str(name): EXPERIMENTS[name] for name in options.experiment}
    needed: list[AnyTrial] = []

    def record(trial: AnyTrial) -> Outcome:
        needed.append(trial)
        return Outcome({})

    for experiment in chosen.values():
        experiment(Study(options, eyes, record))
    outcomes = run_trials(needed, options.seed, options.workers, progress)
    study = Study(options, eyes, outcomes.__getitem__)
    found = {name: experiment(study) for name, experiment in chosen.items()}
    blocks: list[Block] = [_conditions(eyes)]
    for name, findings in found.items():
        blocks.append(Section(name.replace("-", " ").capitalize()))
        blocks += [Text("", findings.verdict)] if findings.verdict else []
        blocks += findings.blocks
    records = {name: findings.record for name, findings in found.items() if findings.record is not None}
    report = Report(
        f"Evaluation of {', '.join(dict.fromkeys(eye.name for eye in eyes))}",
        verdict=" ".join(next((findings.verdict for findings in found.values() if findings.verdict), ())),
        advice=[sentence for findings in found.values() for sentence in findings.advice],
        blocks=blocks,
        inputs=[device_path(device) for device in dict.fromkeys(options.device)],
        record={"options": asdict(options), **records},
    )
    return save_report(report, folder, "report")


def _evaluated_eyes(options: EvaluateOptions) -> list[EvaluatedEye]:
    found = []
    for spec in dict.fromkeys(options.device):
        device = load_device(spec)
        for eye in eyes_of(options.eye):
            width, height, depth = np.round(1e3 * traced_eye(device, eye).eye_box.size, 9).tolist()
            found.append(EvaluatedEye(spec, eye, options.box or (width, height, depth), name=device.name))
    return found


def _conditions(eyes: list[EvaluatedEye]) -> ReportTable:
    rows: list[list[Cell]] = [
        [str(eye), box_text(eye.eye_box_mm), str(truth(eye).field or "whole panel")] for eye in eyes
    ]
    notes = (
        "Captures are taken and errors are stated in this field. It is a choice, and they depend on it: the experiment"
        " 'field' has the whole panel beside it.",
        f"Each rms is over {TEST_RAYS} rays from each of {TEST_VIEWPOINTS} random viewpoints in the eye box.",
    )
    return ReportTable("Conditions", ["eye", "eye box", "field, horizontal x vertical"], rows, notes)
