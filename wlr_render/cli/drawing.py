"""Verbs that draw: a device, frames, comparisons of them, and how fast that is."""

import argparse
from pathlib import Path

from wlr_render.cli.options import Verbs, add_backend, add_eye, add_seed, count, few, new_verb


def _add_demo(verbs: Verbs) -> None:
    text = (
        "the main job: calibrate, draw one scene four ways, look through the true optics, and say in arcminutes how "
        "well each lands on the real object"
    )
    parser = new_verb(verbs, "demo", _demo, text)
    parser.add_argument("--device", default="northstar", help="a shipped device or a device file")
    parser.add_argument("--scene", default="sculpture", help="a shipped scene, a scene file or a mesh")
    parser.add_argument("--viewpoints", type=count, default=7, help="viewpoints in the eye box, 5 or more")
    add_eye(parser)
    add_seed(parser)
    add_backend(parser)


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
    text = (
        "draw a device with its rays, and print field, pixel size, pupil swim, see-through deviation and lateral colour"
    )
    parser = new_verb(verbs, "trace", _trace, text)
    parser.add_argument("device", metavar="DEVICE", help="a shipped device or a device file")
    add_eye(parser)


def _trace(args: argparse.Namespace) -> None:
    from wlr_render.studies import trace_device
    from wlr_render.terminal import print_table

    result = trace_device.run(args.device, args.eye, args.out)
    for table in result.tables:
        print_table(table)
    print(f"The drawing: {result.drawing}")


def _add_render(verbs: Verbs) -> None:
    text = "frames for head and eye trajectories; an interrupted sequence resumes where it stopped"
    parser = new_verb(verbs, "render", _render, text)
    parser.add_argument("headset", metavar="HEADSET", nargs="+", help="a device, or one model file per eye")
    parser.add_argument("scene", metavar="SCENE", help="what stands in the world")
    parser.add_argument("--head", type=Path, help="head trajectory, TUM or EuRoC; at rest if not given")
    parser.add_argument("--eye-track", type=Path, help="eye trajectory; at the eye box's centre if not given")
    parser.add_argument("--eye", choices=("left", "right", "both"), default="right", help="which eyes")
    parser.add_argument("--method", choices=("raster", "raytrace"), default="raster", help="how frames are drawn")
    parser.add_argument("--fps", type=float, default=30.0, help="frames per second")
    parser.add_argument("--frames", type=count, help="at most so many moments")
    parser.add_argument("--supersample", type=few, default=1, help="rays per pixel and axis (raytrace)")
    parser.add_argument("--shadows", action="store_true", help="cast shadows (raytrace)")
    parser.add_argument("--materials", choices=("own", "gltf"), default="own", help="gltf: by pyrender (raster)")
    parser.add_argument(
        "--resolution", type=float, default=1.0, help="raster pixels per display pixel and axis (raster)"
    )
    parser.add_argument("--map-from", choices=("depth", "mesh"), default="depth", help="meet rays with what (raster)")
    parser.add_argument("--maps", choices=("tiff", "pfm"), help="also write each frame's warp map (raster)")
    parser.add_argument(
        "--per-colour",
        action="store_true",
        help="red, green and blue along rays of their own: the device is traced in each, or three model files per eye",
    )
    parser.add_argument("--video", action="store_true", help="also write an .mp4 per eye")
    add_backend(parser)


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
        per_colour=args.per_colour,
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
    parser = new_verb(verbs, "compare", _compare, text)
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
    add_eye(parser)
    add_backend(parser)


def _compare(args: argparse.Namespace) -> None:
    from wlr_render.studies import compare
    from wlr_render.terminal import print_table, progress_bar

    offset = tuple(args.viewpoint_offset_mm)
    options = compare.Options(args.headset, args.scene, args.eye, offset, args.backend, args.out)
    result = compare.run(options, progress_bar)
    print_table(result.table)
    print(f"The picture: {result.picture}")


def _add_bench(verbs: Verbs) -> None:
    text = (
        "how good the program itself is. speed: of frames offline and in real time, against what one would run "
        "otherwise, and how exact they are; minutes. diagnosis: diagnoses of sessions in which an effect is hidden, "
        "judged by what is true. photographs: simulated photographs as they are read, beside exact traces"
    )
    parser = new_verb(verbs, "bench", _bench, text)
    parser.add_argument(
        "what", nargs="?", choices=("speed", "diagnosis", "photographs"), default="speed", help="what to measure"
    )
    speed = parser.add_argument_group("speed")
    add_backend(speed)
    speed.add_argument(
        "--record",
        type=Path,
        metavar="FOLDER",
        help="also keep the figures there, in a file named after what draws; in a checkout those of a GPU are kept in "
        "docs/benchmarks without asking",
    )
    diagnosis = parser.add_argument_group("diagnosis")
    diagnosis.add_argument("--trials", type=count, default=20, help="of every cause; one of each takes minutes")
    diagnosis.add_argument("--workers", type=count, help="processes; one per core if not given")
    add_seed(diagnosis)
    photographs = parser.add_argument_group("photographs")
    photographs.add_argument(
        "--session", type=Path, help="a simulated session, to compare its calibration with the truth"
    )
    photographs.add_argument("--calibration", type=Path, default=Path("out/calibrate"), help="where its results lie")


def _bench(args: argparse.Namespace) -> None:
    from wlr_render.evaluation.report import ReportTable
    from wlr_render.terminal import print_table, progress_bar

    tables: list[ReportTable]
    if args.what == "diagnosis":
        from wlr_render.studies.diagnosis_trials import study

        tables = study.run(study.Options(args.trials, args.seed, args.workers, args.out), progress_bar)
    elif args.what == "photographs":
        from wlr_render.studies.photograph_trials import study as photographs

        options = photographs.Options(args.session, args.calibration, seed=args.seed, out=args.out)
        tables = photographs.run(options, progress_bar)
    else:
        from wlr_render.studies.speed import study as speed

        tables = speed.run(speed.Options(args.backend, args.out, args.record), progress_bar)
    for table in tables:
        print_table(table)


ADDED_BY = (_add_demo, _add_trace, _add_render, _add_compare, _add_bench)
"""One function a verb, in the order in which help lists them."""
