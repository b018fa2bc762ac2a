"""Verbs that draw: a device, frames, comparisons of them."""

import argparse
from pathlib import Path

from wlr_render.cli.options import Verbs, add_backend, add_eye, add_seed, count, few, new_verb
from wlr_render.terminal import say


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
    say(f"The picture: {result.picture}")


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
    say(f"The drawing: {result.drawing}")


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
    say(f"{result.drawn} frames drawn, {result.kept} kept from an earlier run, in {result.folder}")
    for path in result.videos:
        say(f"The video: {path}")


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
    say(f"The picture: {result.picture}")


ADDED_BY = (_add_demo, _add_trace, _add_render, _add_compare)
"""One function a verb, in the order in which help lists them."""
