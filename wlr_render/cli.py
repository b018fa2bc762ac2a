"""The command line: parses, calls one study, prints. No formulas.

A new verb is one `_add_...` function, which says its options and what runs, and its place in `_VERBS`.
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

from wlr_render.errors import BadInputError

Command = Callable[[argparse.Namespace], None]
Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit status: 0, 2 for bad input, 130 when interrupted."""
    args = _parser().parse_args(arguments)
    # Before numpy is imported: on thin matrix products BLAS threads are slower than none, many times so on a machine
    # that is busy otherwise. Work is shared out over threads and processes elsewhere.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    command: Command = args.command
    try:
        command(args)
    except BadInputError as error:
        if args.debug:
            raise
        print(f"wlr-render: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        # Whoever read the output has seen enough, e.g. `| head`; Python must not complain again when it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print("wlr-render: interrupted; what is finished is kept.", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="wlr-render",
        description="World-locked rendering for augmented-reality glasses.",
        epilog="HEADSET is a shipped device by name, a device file (.toml) or a fitted model (.json); SCENE a shipped "
        "scene by name, a scene file (.toml) or a mesh (.glb, .gltf, .obj, .ply). Frames, units and pixels: "
        "docs/conventions.md.",
    )
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    for add in _VERBS:
        add(verbs)
    return parser


def _verb(verbs: Verbs, name: str, command: Command, text: str) -> argparse.ArgumentParser:
    """A verb with the options that all have."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        name, help=text, description=text, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.set_defaults(command=command)
    parser.add_argument("--out", type=Path, default=Path("out") / name, help="folder for the results")
    parser.add_argument("--debug", action="store_true", help="show the traceback of a fault")
    return parser


def _add_eye(parser: argparse._ActionsContainer) -> None:
    parser.add_argument("--eye", choices=("left", "right"), default="right", help="which eye")


def _add_seed(parser: argparse._ActionsContainer) -> None:
    parser.add_argument("--seed", type=_seed, default=1, help="of all random numbers")


def _add_backend(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--backend",
        choices=("auto", "egl", "osmesa", "cpu"),
        default="auto",
        help="who rasterises: OpenGL by EGL or OSMesa, or the CPU; auto takes the first that works",
    )


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not 1 or more")
    return value


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value} is not 0 or more")
    return value


def _few(text: str) -> int:
    """Degrees and rays per pixel and axis: beyond this they only cost time."""
    value = _count(text)
    if value > 12:
        raise argparse.ArgumentTypeError(f"{value} is more than 12")
    return value


def _not_negative(text: str) -> float:
    value = float(text)
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{value} is not a number of 0 or more")
    return value


def _add_demo(verbs: Verbs) -> None:
    text = (
        "the main job: calibrate, draw one scene four ways, look through the true optics, and say in arcminutes how "
        "well each lands on the real object"
    )
    parser = _verb(verbs, "demo", _demo, text)
    parser.add_argument("--device", default="northstar", help="a shipped device or a device file")
    parser.add_argument("--scene", default="sculpture", help="a shipped scene, a scene file or a mesh")
    parser.add_argument("--viewpoints", type=_count, default=7, help="viewpoints in the eye box, 5 or more")
    _add_eye(parser)
    _add_seed(parser)
    _add_backend(parser)


def _demo(args: argparse.Namespace) -> None:
    from wlr_render.studies import alignment_demo
    from wlr_render.terminal import print_table, progress_bar

    options = alignment_demo.Options(
        args.device, args.scene, args.eye, args.viewpoints, args.seed, args.backend, args.out
    )
    result = alignment_demo.run(options, progress_bar)
    for table in result.tables:
        print_table(table)
    print(f"The picture: {result.picture}")


def _add_trace(verbs: Verbs) -> None:
    text = "draw a device with its rays, and print field, pixel size, pupil swim and see-through deviation"
    parser = _verb(verbs, "trace", _trace, text)
    parser.add_argument("device", metavar="DEVICE", help="a shipped device or a device file")
    _add_eye(parser)


def _trace(args: argparse.Namespace) -> None:
    from wlr_render.studies import trace_device
    from wlr_render.terminal import print_table

    result = trace_device.run(args.device, args.eye, args.out)
    print_table(result.table)
    print(f"The drawing: {result.drawing}")


def _add_calibrate(verbs: Verbs) -> None:
    parser = _verb(verbs, "calibrate", _calibrate, "fit an eye's models to simulated or given captures")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--simulate", metavar="DEVICE", help="simulate the captures of a device")
    source.add_argument("--captures", type=Path, metavar="PATH", help="fit a capture file (.npz) or a session's folder")
    kinds = ("planar", "volumetric", "static", "point-per-pixel")
    parser.add_argument("--kind", choices=kinds, default="planar", help="of model")
    parser.add_argument("--degree", type=_few, help="of the display; chosen by held-out viewpoints if not given")
    parser.add_argument("--see-through-degree", type=_few, help="likewise for see-through")
    session = parser.add_argument_group("with --captures and a session's folder")
    session.add_argument("--bench", type=Path, metavar="FILE", help="read the session by this bench, not by its own")
    simulated = parser.add_argument_group("with --simulate")
    simulated.add_argument("--viewpoints", type=_count, default=25, help="camera positions")
    simulated.add_argument("--noise-px", type=_not_negative, default=0.25, help="camera noise; a pixel is 1 arcmin")
    simulated.add_argument("--stage-error-mm", type=_not_negative, default=0.0, help="of each position, per axis")
    _add_eye(simulated)
    _add_seed(simulated)


def _calibrate(args: argparse.Namespace) -> None:
    from wlr_render.studies import calibrate
    from wlr_render.terminal import print_table

    fit = calibrate.FitOptions(args.kind, args.degree, args.see_through_degree)
    if args.captures:
        result = calibrate.calibrate_from_captures(args.captures, args.out, fit, args.bench)
    else:
        simulation = calibrate.SimulationOptions(args.viewpoints, args.noise_px, args.stage_error_mm, args.seed)
        result = calibrate.calibrate_simulated(args.simulate, args.out, args.eye, simulation, fit)
    for table in result.tables:
        print_table(table)
    print("Written: " + ", ".join(str(path) for path in result.files))


def _add_evaluate(verbs: Verbs) -> None:
    text = "Monte Carlo comparison of planar, volumetric, static and point-per-pixel models on simulated captures"
    parser = _verb(verbs, "evaluate", _evaluate, text)
    parser.add_argument("--preset", choices=("quick", "full"), default="quick", help="how much to compute")
    parser.add_argument("--device", action="append", help="repeat for several; the see-through devices if not given")
    parser.add_argument("--experiment", action="append", help="repeat for several; all if not given")
    parser.add_argument("--workers", type=_count, help="processes; one per core if not given")
    _add_seed(parser)


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
    print("Written: " + ", ".join(str(path) for path in sampling_study.write(report, args.out)))


def _add_render(verbs: Verbs) -> None:
    text = "frames for head and eye trajectories; an interrupted sequence resumes where it stopped"
    parser = _verb(verbs, "render", _render, text)
    parser.add_argument("headset", metavar="HEADSET", nargs="+", help="a device, or one model file per eye")
    parser.add_argument("scene", metavar="SCENE", help="what stands in the world")
    parser.add_argument("--head", type=Path, help="head trajectory, TUM or EuRoC; at rest if not given")
    parser.add_argument("--eye-track", type=Path, help="eye trajectory; at the eye box's centre if not given")
    parser.add_argument("--eye", choices=("left", "right", "both"), default="right", help="which eyes")
    parser.add_argument("--method", choices=("raster", "raytrace"), default="raster", help="how frames are drawn")
    parser.add_argument("--fps", type=float, default=30.0, help="frames per second")
    parser.add_argument("--frames", type=_count, help="at most so many moments")
    parser.add_argument("--supersample", type=_few, default=1, help="rays per pixel and axis (raytrace)")
    parser.add_argument("--shadows", action="store_true", help="cast shadows (raytrace)")
    parser.add_argument("--materials", choices=("own", "gltf"), default="own", help="gltf: by pyrender (raster)")
    parser.add_argument(
        "--resolution", type=float, default=1.0, help="raster pixels per display pixel and axis (raster)"
    )
    parser.add_argument("--map-from", choices=("depth", "mesh"), default="depth", help="meet rays with what (raster)")
    parser.add_argument("--maps", choices=("tiff", "pfm"), help="also write each frame's warp map (raster)")
    parser.add_argument("--video", action="store_true", help="also write an .mp4 per eye")
    _add_backend(parser)


def _render(args: argparse.Namespace) -> None:
    from wlr_render.studies import render_sequence
    from wlr_render.terminal import progress_bar

    options = render_sequence.Options(
        headset=tuple(args.headset),
        scene=args.scene,
        head=args.head,
        eyes_file=args.eye_track,
        eyes=("left", "right") if args.eye == "both" else (args.eye,),
        method=args.method,
        frames_per_second=args.fps,
        frame_limit=args.frames,
        supersample=args.supersample,
        shadows=args.shadows,
        materials=args.materials,
        resolution=args.resolution,
        map_from=args.map_from,
        maps=args.maps,
        video=args.video,
        backend=args.backend,
        out=args.out,
    )
    result = render_sequence.run(options, progress_bar)
    print(f"{result.drawn} frames drawn, {result.kept} kept from an earlier run, in {result.folder}")
    for path in result.videos:
        print(f"The video: {path}")


def _add_compare(verbs: Verbs) -> None:
    text = "the error that rasterisation brings: one frame rastered and ray traced, compared pixel by pixel"
    parser = _verb(verbs, "compare", _compare, text)
    parser.add_argument("headset", metavar="HEADSET", help="a device or a model file")
    parser.add_argument("scene", metavar="SCENE", help="what stands in the world")
    parser.add_argument(
        "--viewpoint-offset-mm",
        type=float,
        nargs=3,
        default=(0.0, 0.0, 0.0),
        metavar=("X", "Y", "Z"),
        help="from the eye box's centre, device frame (x right, y up)",
    )
    _add_eye(parser)
    _add_backend(parser)


def _compare(args: argparse.Namespace) -> None:
    from wlr_render.studies import compare
    from wlr_render.terminal import print_table, progress_bar

    offset = tuple(args.viewpoint_offset_mm)
    options = compare.Options(args.headset, args.scene, args.eye, offset, args.backend, args.out)
    result = compare.run(options, progress_bar)
    print_table(result.table)
    print(f"The picture: {result.picture}")


def _add_diagnose(verbs: Verbs) -> None:
    text = (
        "say whether a bench as described predicts what was measured on it, and if not, which physical causes explain "
        "it; writes a report and the extended bench"
    )
    parser = _verb(verbs, "diagnose", _diagnose, text)
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
    print(result.sentence, *(f"- {line}" for line in (*result.warnings, *result.advice)), sep="\n", end="\n\n")
    for table in result.tables:
        print_table(table)
    print("Written: " + ", ".join(str(path) for path in result.files))


def _add_hold_out(verbs: Verbs) -> None:
    text = "diagnose a session, and say how well the causes found predict captures and distances not fitted to"
    parser = _verb(verbs, "hold-out", _hold_out, text)
    parser.add_argument("session", metavar="SESSION", type=Path, help="a bench session's folder")


def _hold_out(args: argparse.Namespace) -> None:
    from wlr_render.studies import hold_out
    from wlr_render.terminal import print_table, status_line

    with status_line() as tell:
        result = hold_out.run(args.session, args.out, tell)
    print_table(result.table)


def _add_import(verbs: Verbs) -> None:
    parser = _verb(verbs, "import", _import, "write a measured set of others as a bench session, to be diagnosed")
    parser.add_argument("format", choices=("itoh-seethrough",), help="what the set is")
    parser.add_argument("source", metavar="FOLDER", type=Path, help="of the set, as docs/measured-data.md says")


def _import(args: argparse.Namespace) -> None:
    from wlr_render.studies import import_session

    made = import_session.FORMATS[args.format](args.source, args.out)
    print(f"{made.captures} captures, {made.readings} readings that scatter by {made.sigma_px:.3f} px: {made.folder}")


def _add_viewpoints(verbs: Verbs) -> None:
    text = "which display model the captures of a headset from two viewpoints support, and what is due to the rig"
    parser = _verb(verbs, "viewpoints", _viewpoints, text)
    parser.add_argument("captures", metavar="FOLDER", type=Path, help="North Star captures, see docs/measured-data.md")


def _viewpoints(args: argparse.Namespace) -> None:
    from wlr_render.studies import viewpoints
    from wlr_render.terminal import print_table

    for table in viewpoints.run(args.captures, args.out):
        print_table(table)


def _add_bench(verbs: Verbs) -> None:
    text = "speed as ratios against what one would run otherwise, exactness of the fast map, memory"
    parser = _verb(verbs, "bench", _bench, text)
    _add_backend(parser)


def _bench(args: argparse.Namespace) -> None:
    from wlr_render.studies import bench
    from wlr_render.terminal import print_table, progress_bar

    for table in bench.run(bench.Options(args.backend, args.out), progress_bar):
        print_table(table)


_VERBS = (
    _add_demo,
    _add_trace,
    _add_calibrate,
    _add_evaluate,
    _add_render,
    _add_compare,
    _add_diagnose,
    _add_hold_out,
    _add_import,
    _add_viewpoints,
    _add_bench,
)
