"""Verbs that fit models to captures, and explain what was measured."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from wlr_render.cli.options import Verbs, add_eye, add_seed, count, few, new_verb, not_negative
from wlr_render.terminal import say

if TYPE_CHECKING:
    from wlr_render.studies.calibrate import FitOptions


def _add_calibrate(verbs: Verbs) -> None:
    text = "fit an eye's models: from a session of photographs, from captures given as numbers, or from simulated ones"
    parser = new_verb(verbs, "calibrate", _calibrate, text)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("session", metavar="SESSION", type=Path, nargs="?", help="folder of photographs, session.toml")
    source.add_argument("--simulate", metavar="DEVICE", help="simulate the captures of a device")
    source.add_argument("--captures", type=Path, metavar="PATH", help="fit a capture file (.npz) or a session's folder")
    kinds = ("planar", "volumetric", "static", "point-per-pixel")
    parser.add_argument("--kind", choices=kinds, default="planar", help="of model")
    parser.add_argument("--degree", type=few, help="of the display; chosen by held-out viewpoints if not given")
    parser.add_argument("--see-through-degree", type=few, help="likewise for see-through")
    photographs = parser.add_argument_group("with SESSION")
    photographs.add_argument("--workers", type=count, help="processes that read photographs; up to 3 if not given")
    session = parser.add_argument_group("with --captures and a session's folder")
    session.add_argument("--bench", type=Path, metavar="FILE", help="read the session by this bench, not by its own")
    simulated = parser.add_argument_group("with --simulate")
    simulated.add_argument("--viewpoints", type=count, default=25, help="camera positions")
    simulated.add_argument("--noise-px", type=not_negative, default=0.25, help="camera noise; a pixel is 1 arcmin")
    simulated.add_argument("--stage-error-mm", type=not_negative, default=0.0, help="of each position, per axis")
    add_eye(simulated)
    add_seed(simulated)


def _calibrate(args: argparse.Namespace) -> None:
    from wlr_render.studies import calibrate
    from wlr_render.terminal import print_table

    fit = calibrate.FitOptions(args.kind, args.degree, args.see_through_degree)
    if args.session:
        _calibrate_photographs(args, fit)
        return
    if args.captures:
        result = calibrate.calibrate_from_captures(args.captures, args.out, fit, args.bench)
    else:
        simulation = calibrate.SimulationOptions(args.viewpoints, args.noise_px, args.stage_error_mm, args.seed)
        result = calibrate.calibrate_simulated(args.simulate, args.out, args.eye, simulation, fit)
    for table in result.tables:
        print_table(table)
    say("Written: " + ", ".join(str(path) for path in result.files))


def _calibrate_photographs(args: argparse.Namespace, fit: "FitOptions") -> None:
    from wlr_render.errors import BadInputError
    from wlr_render.studies.photo_sessions import calibrate, report
    from wlr_render.terminal import print_table, progress_bar

    result = calibrate.run(args.session, args.out, fit, args.workers, progress_bar)
    told = report.write(result, args.out)
    for table in told.tables:
        print_table(table)
    say("Written: " + ", ".join(str(path) for path in told.files))
    for name, reason in result.left_out:
        say(f"wlr-render: set aside {name}: {reason}", error=True)
    if result.faults:
        raise BadInputError(
            f"{args.session}: results are without {len(result.faults)} faulty item(s): {', '.join(result.faults)}."
        )


def _add_evaluate(verbs: Verbs) -> None:
    text = "Monte Carlo comparison of planar, volumetric, static and point-per-pixel models on simulated captures"
    parser = new_verb(verbs, "evaluate", _evaluate, text)
    parser.add_argument("--preset", choices=("quick", "full"), default="quick", help="how much to compute")
    parser.add_argument("--device", action="append", help="repeat for several; the see-through devices if not given")
    parser.add_argument("--experiment", action="append", help="repeat for several; all if not given")
    parser.add_argument("--workers", type=count, help="processes; one per core if not given")
    add_seed(parser)


def _evaluate(args: argparse.Namespace) -> None:
    from dataclasses import replace

    from wlr_render.files import output_folder
    from wlr_render.studies import sampling_study
    from wlr_render.terminal import print_table, progress_bar

    options = sampling_study.FULL if args.preset == "full" else sampling_study.QUICK
    options = replace(
        options,
        devices=tuple(args.device or options.devices),
        experiments=tuple(args.experiment or ()),
        seed=args.seed,
        workers=args.workers,
    )
    output_folder(args.out)  # a minute's work must not end at a folder that cannot be written
    report = sampling_study.run(options, progress_bar)
    for table in report.tables:
        print_table(table)
    say("Written: " + ", ".join(str(path) for path in sampling_study.write(report, args.out)))


def _add_diagnose(verbs: Verbs) -> None:
    text = (
        "say whether a bench as described predicts what was measured on it, and if not, which physical causes explain "
        "it; writes a report and the extended bench"
    )
    parser = new_verb(verbs, "diagnose", _diagnose, text)
    parser.add_argument("session", metavar="SESSION", type=Path, help="a bench session's folder")
    parser.add_argument(
        "--bench", type=Path, metavar="FILE", help="compare with this bench, not with the session's own"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="the record; diagnosis.json in --out if not given")
    parser.add_argument("--html", type=Path, metavar="FILE", help="the page; diagnosis.html in --out if not given")


def _diagnose(args: argparse.Namespace) -> None:
    from wlr_render.studies import diagnose
    from wlr_render.terminal import print_table, status_line

    with status_line() as tell:
        result = diagnose.run(diagnose.Options(args.session, args.out, args.json, args.html, args.bench), tell)
    say(result.sentence, *(f"- {line}" for line in (*result.warnings, *result.advice)), "")
    say("The search for causes:", *(f"- {line}" for line in result.reasons), "")
    for table in result.tables:
        print_table(table)
    say("Written: " + ", ".join(str(path) for path in result.files))


def _add_hold_out(verbs: Verbs) -> None:
    text = "diagnose a session, and say how well the causes found predict captures and distances not fitted to"
    parser = new_verb(verbs, "hold-out", _hold_out, text)
    parser.add_argument("session", metavar="SESSION", type=Path, help="a bench session's folder")


def _hold_out(args: argparse.Namespace) -> None:
    from wlr_render.studies import hold_out
    from wlr_render.terminal import print_table, status_line

    with status_line() as tell:
        result = hold_out.run(args.session, args.out, tell)
    print_table(result.table)


def _add_import(verbs: Verbs) -> None:
    parser = new_verb(verbs, "import", _import, "write a measured set of others as a bench session, to be diagnosed")
    parser.add_argument("format", choices=("itoh-seethrough",), help="what the set is")
    parser.add_argument("source", metavar="FOLDER", type=Path, help="of the set, as docs/measured-data.md says")


def _import(args: argparse.Namespace) -> None:
    from wlr_render.studies import import_session

    made = import_session.FORMATS[args.format](args.source, args.out)
    say(f"{made.captures} captures, {made.readings} readings that scatter by {made.sigma_px:.3f} px: {made.folder}")


ADDED_BY = (_add_calibrate, _add_evaluate, _add_diagnose, _add_hold_out, _add_import)
"""One function a verb, in the order in which help lists them."""
