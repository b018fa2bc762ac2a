"""`python -m benchmarks NAME [OPTIONS]`: run one benchmark of the program and print its tables."""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from wlr_render.errors import BadInputError
from wlr_render.progress import Progress
from wlr_render.report.blocks import Report, ReportTable
from wlr_render.report.terminal import print_report, say, terminal_progress

Command = Callable[[argparse.Namespace, Progress], Sequence[ReportTable]]

BACKENDS = ("auto", "egl", "osmesa", "cpu")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one benchmark; returns the exit status: 0, 2 for bad input, 130 when interrupted."""
    args = _parser().parse_args(arguments)
    # As wlr-render does, before numpy is imported: BLAS threads slow down the thin matrix products here.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    command: Command = args.command
    try:
        with terminal_progress() as progress:
            tables = command(args, progress)
    except BadInputError as error:
        say(f"benchmarks: {error}", error=True)
        return 2
    except KeyboardInterrupt:
        say("benchmarks: interrupted.", error=True)
        return 130
    print_report(Report("", blocks=list(tables)))
    say(f"Written into {args.out}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Benchmarks of the program; benchmarks/README.md says what each measures and how long it takes.",
    )
    names = parser.add_subparsers(required=True, metavar="NAME")

    def new(name: str, command: Command, text: str) -> argparse.ArgumentParser:
        made = names.add_parser(
            name, help=text, description=text, formatter_class=argparse.ArgumentDefaultsHelpFormatter
        )
        made.set_defaults(command=command)
        made.add_argument("--out", type=Path, default=Path("out/benchmarks") / name, help="folder for the results")
        return made

    speed = new("speed", _speed, "Speed of frames, offline and in real time, against baselines, and their accuracy.")
    speed.add_argument("--backend", choices=BACKENDS, default="auto", help="rendering backend")
    speed.add_argument("--record", type=Path, metavar="FOLDER", help="also keep the tables there, as RENDERER.md")

    soak = new("soak", _soak, "Soak test: many frames for a moving wearer; frame times, memory, map errors.")
    soak.add_argument("headset", metavar="HEADSET", nargs="+", help="a device, or one model file per eye")
    soak.add_argument("scene", metavar="SCENE", help="a shipped scene, a scene file or a mesh")
    soak.add_argument("--head", type=Path, help="head trajectory, TUM or EuRoC (default: synthetic)")
    soak.add_argument("--eye-track", type=Path, help="eye trajectory (default: synthetic, with blinks and dropouts)")
    soak.add_argument("--eye", choices=("left", "right", "both"), default="right", help="which eyes")
    soak.add_argument("--frames", type=_count, default=1000, help="number of frames, 2 or more")
    soak.add_argument("--fps", type=float, default=90.0, help="frames per second")
    soak.add_argument("--size", type=_size, metavar="WxH", help="pixels of each eye's picture (default: the panel's)")
    soak.add_argument(
        "--late-ms",
        type=float,
        default=0.0,
        help="late-warp latency: compose for a head pose this many ms newer than the rendered one",
    )
    soak.add_argument(
        "--solve",
        choices=("auto", "pixels", "nodes"),
        default="auto",
        help="solve the map at every pixel (planar models), or on a grid of measured error",
    )
    _add_seed(soak)
    soak.add_argument("--backend", choices=BACKENDS, default="auto", help="rendering backend")

    diagnosis = new("diagnosis", _diagnosis, "Diagnoses of simulated sessions with hidden effects, scored.")
    diagnosis.add_argument("--trials", type=_count, default=20, help="trials of every cause; one of each takes minutes")
    diagnosis.add_argument("--workers", type=_count, help="processes (default: one per core)")
    _add_seed(diagnosis)

    photographs = new("photographs", _photographs, "Readings of simulated photographs, compared with exact traces.")
    photographs.add_argument("--session", type=Path, help="also compare the calibration of this simulated session")
    photographs.add_argument(
        "--calibration", type=Path, default=Path("out/calibrate"), help="folder of that session's calibration"
    )
    _add_seed(photographs)

    two_views = new("two-views", _two_views, "Pupil models supported by decoded captures from two viewpoints.")
    two_views.add_argument("captures", metavar="FOLDER", type=Path, help="North Star captures: docs/measured-data.md")
    return parser


def _speed(args: argparse.Namespace, progress: Progress) -> Sequence[ReportTable]:
    from benchmarks.speed import study

    return study.run(study.Options(args.backend, args.out, args.record), progress)


def _soak(args: argparse.Namespace, progress: Progress) -> Sequence[ReportTable]:
    from benchmarks.soak import study
    from benchmarks.soak.wearer import Wearer

    options = study.Options(
        headset=tuple(args.headset),
        scene=args.scene,
        eyes=("left", "right") if args.eye == "both" else (args.eye,),
        wearer=Wearer(args.head, args.eye_track, args.seed),
        frames=args.frames,
        frames_per_second=args.fps,
        late_ms=args.late_ms,
        size=args.size,
        context=args.backend,
        solve=args.solve,
        out=args.out,
    )
    return study.run(options, progress).tables


def _diagnosis(args: argparse.Namespace, progress: Progress) -> Sequence[ReportTable]:
    from benchmarks.diagnosis import study

    return study.run(study.Options(args.trials, args.seed, args.workers, args.out), progress)


def _photographs(args: argparse.Namespace, progress: Progress) -> Sequence[ReportTable]:
    from benchmarks.photographs import study

    options = study.Options(args.session, args.calibration, seed=args.seed, out=args.out)
    return study.run(options, progress)


def _two_views(args: argparse.Namespace, progress: Progress) -> Sequence[ReportTable]:
    from benchmarks.two_views import study

    return study.run(args.captures, args.out)


def _add_seed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=int, default=1, help="seed of all random numbers")


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not 1 or more")
    return value


def _size(text: str) -> tuple[int, int]:
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"'{text}' is not a width and a height, as in 1920x1080")
    return _count(width), _count(height)


if __name__ == "__main__":
    sys.exit(main())
