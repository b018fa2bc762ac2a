"""Verbs of the real-time path."""

import argparse
from pathlib import Path

from wlr_render.cli.options import Verbs, add_backend, add_seed, count, new_verb, not_negative, size


def _add_stream(verbs: Verbs) -> None:
    text = (
        "a long run of frames for a moving wearer, each with a map of its own: frame times, memory, blinks, lost "
        "tracking, saccades, and what did not converge"
    )
    parser = new_verb(verbs, "stream", _stream, text)
    parser.add_argument("headset", metavar="HEADSET", nargs="+", help="a device, or one model file per eye")
    parser.add_argument("scene", metavar="SCENE", help="what stands in the world")
    parser.add_argument("--head", type=Path, help="head trajectory, TUM or EuRoC; made up if not given")
    parser.add_argument(
        "--eye-track", type=Path, help="eye trajectory; made up, with blinks and dropouts, if not given"
    )
    parser.add_argument("--eye", choices=("left", "right", "both"), default="right", help="which eyes")
    parser.add_argument("--frames", type=count, default=1000, help="2 or more")
    parser.add_argument("--fps", type=float, default=90.0, help="frames per second")
    parser.add_argument("--size", type=size, metavar="WxH", help="pixels of each eye's picture; the panel's by default")
    parser.add_argument(
        "--late-ms", type=not_negative, default=0.0, help="compose for a head pose so much newer than what was drawn"
    )
    parser.add_argument(
        "--solve",
        choices=("auto", "pixels", "nodes"),
        default="auto",
        help="the map at every pixel (planar models), or on a grid of measured error",
    )
    add_seed(parser)
    add_backend(parser)


def _stream(args: argparse.Namespace) -> None:
    from wlr_render.studies.streaming import study
    from wlr_render.studies.streaming.wearer import Wearer
    from wlr_render.terminal import print_table, progress_bar

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
    result = study.run(options, progress_bar)
    for table in result.tables:
        print_table(table)
    print("Written: " + ", ".join(str(path) for path in result.files))


ADDED_BY = (_add_stream,)
"""One function a verb, in the order in which help lists them."""
