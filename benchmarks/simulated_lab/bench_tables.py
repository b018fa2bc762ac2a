"""Tables of simulated benches: acceptance, errors over stated sigmas, faults named, errors of models."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from benchmarks.intervals import INTERVAL, interval_percent, ratio_interval
from benchmarks.simulated_lab.bench_models import CALIBRATED, EXACT, NOMINAL, PREDICTED
from benchmarks.simulated_lab.bench_trial import DEVICES, FAULTY, BenchOutcome, BenchTrialKind
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, ReportTable

_SHORT = 160  # largest number of characters of a sentence


def bench_tables(outcomes: Sequence[BenchOutcome]) -> list[ReportTable]:
    """Return all tables, except tables without trials."""
    makers = (_accepted, _alarms, _sigmas, _components, _faults, _unnamed, _models)
    return [table for table in (make(outcomes) for make in makers) if table.rows]


def _of(outcomes: Sequence[BenchOutcome], *kinds: BenchTrialKind) -> list[BenchOutcome]:
    return [each for each in outcomes if each.trial.kind in kinds]


def _clean(outcomes: Sequence[BenchOutcome]) -> list[BenchOutcome]:
    return _of(outcomes, BenchTrialKind.CLEAN, BenchTrialKind.MODELS)


def _accepted(outcomes: Sequence[BenchOutcome]) -> ReportTable:
    rows: list[list[Cell]] = []
    clean = _clean(outcomes)
    for device in (*DEVICES, "all"):
        own = [each for each in clean if device in (each.trial.device, "all")]
        if own:
            accepted, alarmed = sum(each.accepted for each in own), sum(bool(each.failed) for each in own)
            seconds = float(np.median([each.seconds for each in own]))
            rows.append(
                [device, len(own), accepted, alarmed, interval_percent(alarmed, len(own)), seconds],
            )
    notes = (
        "Ordinary imperfections (`BenchImperfections` or `Workshop`), readings as of 8-bit photographs. "
        "Wanted: all accepted, a failed check in at most 2 %.",
        "Accepted: no check contradicts the session. Seconds: of one processor, for the calibration of the bench; a "
        "busy machine lengthens them.",
    )
    columns = ["headset", "sessions", "accepted", "with a failed check", INTERVAL, "seconds, median"]
    return ReportTable("Sessions without faults", columns, rows, notes)


def _alarms(outcomes: Sequence[BenchOutcome]) -> ReportTable:
    rows: list[list[Cell]] = [
        [f"{each.trial.device} {each.trial.number}", check.step, check.sentence[:_SHORT]]
        for each in _clean(outcomes)
        for check in (*each.failed, *each.excluded)
    ]
    return ReportTable("Failed checks and excluded photographs of sessions without faults", ["session", "", ""], rows)


def _sigmas(outcomes: Sequence[BenchOutcome]) -> ReportTable:
    clean = [each for each in _of(outcomes, BenchTrialKind.CLEAN) if each.sigmas]
    rows: list[list[Cell]] = []
    for kind in clean[0].sigmas if clean else ():
        squares = np.array([[each.sigmas[kind].mean_square, each.sigmas[kind].joint] for each in clean])
        found = np.sqrt(squares.mean(axis=0))
        (low, high), joint = _interval(squares[:, 0]), _interval(squares[:, 1])
        rows.append([kind, found[0], f"{low:.2f} to {high:.2f}", found[1], f"{joint[0]:.2f} to {joint[1]:.2f}"])
    notes = (
        "Rms of all components, each over its own stated sigma; and the root of chi-squared by their joint covariance "
        "over their number. Wanted: 0.8 to 1.3. Intervals: 95 %, bootstrap over sessions, since errors of one session "
        "are dependent.",
        "In the device frame nearly all of a pose's error comes from the stated pose of the tracking camera, one "
        "draw a session.",
        "Poses of targets are fitted to the features of the board; the shape is the residual of the features. "
        "Directions cover pixels over the whole picture.",
    )
    columns = ["unknown", "error / sigma, rms", "95 % interval", "by joint covariance", "95 % interval, joint"]
    return ReportTable(f"Errors over stated sigmas, {len(clean)} sessions", columns, rows, notes)


def _interval(squares: FloatArray) -> tuple[float, float]:
    low, high = np.sqrt(ratio_interval(squares, np.ones(len(squares))))
    return float(low), float(high)


def _components(outcomes: Sequence[BenchOutcome]) -> ReportTable:
    """Tabulate the estimated and the true variance components; the latter are numbers in the first family only."""
    clean = [each for each in _clean(outcomes) if each.sizes]
    true: dict[str, tuple[float, float | None, str]] = {
        "turn": (1e6, 10.0, "random rotation of the stage, urad"),
        "shift": (1e6, 5.0, "random displacement of the stage, um"),
        "noise eyeball": (1.0, 1.0, "noise over stated sigma, eyeball camera"),
        "noise tracking": (1.0, 1.0, "noise over stated sigma, tracking camera"),
        "features board": (1e6, 10.0 * float(np.sqrt(2.0 / 3.0)), "displacement of features on the board, um"),
    }
    is_known = all(each.trial.family == "polynomial" for each in clean)
    rows: list[list[Cell]] = []
    for name, (unit, value, text) in true.items():
        found = unit * np.array([each.sizes[name] for each in clean if name in each.sizes])
        if len(found):
            rows.append(
                [text, value if is_known else None, *(float(one) for one in np.quantile(found, [0.5, 0.0, 1.0]))]
            )
    return ReportTable("Variance components found", ["component", "true", "median", "least", "most"], rows)


def _faults(outcomes: Sequence[BenchOutcome]) -> ReportTable:
    rows: list[list[Cell]] = []
    for kinds in (*((kind,) for kind in FAULTY), FAULTY):
        own = _of(outcomes, *kinds)
        if own:
            named, alone = sum(each.named for each in own), sum(each.named and each.first for each in own)
            text = str(kinds[0]) if len(kinds) == 1 else "all"
            rows.append([text, len(own), named, interval_percent(named, len(own)), alone])
    notes = (
        "Moves and slips by 0.5 to 2 mm and 0.05 to 0.2 degrees. Named: a failed check or an excluded photograph names "
        "the target pose and what moved, both photographs, or both axes. Wanted: 95 %.",
    )
    columns = ["fault", "sessions", "named", INTERVAL, "named and nothing else"]
    return ReportTable("One thing wrong", columns, rows, notes)


def _unnamed(outcomes: Sequence[BenchOutcome]) -> ReportTable:
    rows: list[list[Cell]] = []
    for each in _of(outcomes, *FAULTY):
        if not (each.named and each.first):
            said = [check.sentence[:_SHORT] for check in (*each.failed, *each.excluded)] or [each.refused[:_SHORT]]
            trial = f"{each.trial.kind}, {each.trial.device} {each.trial.number}"
            counted = Counter(said)
            text = "; ".join(f"{sentence}" for sentence in counted) or "nothing"
            rows.append([trial, each.truth, "yes" if each.named else "no", text])
    return ReportTable("Faults that were not named, or not alone", ["session", "truth", "named", "said"], rows)


def _models(outcomes: Sequence[BenchOutcome]) -> ReportTable:
    rows: list[list[Cell]] = []
    own = [each for each in _of(outcomes, BenchTrialKind.MODELS) if each.errors]
    for error in own[0].errors[CALIBRATED] if own else ():
        ratios = []
        for each in own:
            found = [each.errors[source][error] for source in (CALIBRATED, EXACT, NOMINAL)]
            predicted = each.errors[PREDICTED].get(error, np.nan)
            ratios.append([found[0] / found[1], found[2] / found[1], found[0] / found[2], found[0] / predicted])
            session = f"{each.trial.device} {each.trial.number}"
            rows.append([error, session, *found, *ratios[-1]])
        median = [float(one) for one in np.median(ratios, axis=0)]
        rows.append([error, "median", None, None, None, *median])
    columns = ["error, rms", "session", CALIBRATED, EXACT, NOMINAL]
    columns += ["calibrated / exact", "random motion / exact", "calibrated / random motion", "calibrated / predicted"]
    notes = (
        "Models of the same readings: with the calibrated bench; with the true lenses, board, target and camera poses; "
        "and with these, but camera poses without the stage's random errors and its creep. Errors are "
        "against the traced headset, of calibrated models in the frame of the tracking camera. Wanted: calibrated / "
        "exact at most 1.5.",
    )
    return ReportTable("Models, compared with models from exact numbers with the same noise", columns, rows, notes)
