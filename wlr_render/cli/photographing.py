"""Verbs about photographs: what is shown and printed for them, taking, reading and judging by them."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from wlr_render.cli.options import Verbs, add_backend, add_eye, add_seed, count, new_verb, not_negative, size
from wlr_render.terminal import say

if TYPE_CHECKING:
    from wlr_render.studies.verification import verify


def _add_simulate(verbs: Verbs) -> None:
    text = "write the folder of a calibration session as a lab would: photographs through a device's true optics"
    parser = new_verb(verbs, "simulate", _simulate, text, out=False)
    parser.add_argument("session", metavar="SESSION", type=Path, help="the folder; interrupted work goes on there")
    parser.add_argument("--device", default="freeform40", help="a shipped device or a device file")
    parser.add_argument("--viewpoints", type=count, default=25, help="camera positions")
    parser.add_argument("--pattern", choices=("gray", "fringes", "gray-fringes"), default="gray-fringes", help="shown")
    parser.add_argument("--camera", type=size, default="1280x1024", metavar="WxH", help="pixels of the eyeball camera")
    parser.add_argument("--bits", type=int, choices=(8, 10, 12), default=8, help="of the eyeball camera")
    parser.add_argument("--pupil-mm", type=not_negative, default=0.5, help="diameter of its entrance pupil")
    parser.add_argument("--focus-m", type=not_negative, default=1.0, help="where it is focused")
    parser.add_argument("--snr", type=not_negative, default=50.0, help="signal over noise of a white panel")
    parser.add_argument(
        "--depths-m", type=not_negative, nargs="+", default=[0.4, 1.0], help="of the target, two or more"
    )
    parser.add_argument("--stage-error-um", type=not_negative, default=2.0, help="of each camera position, per axis")
    parser.add_argument(
        "--workers", type=count, help="processes; one per core, but not more than memory allows, if not given"
    )
    add_eye(parser)
    add_seed(parser)


def _simulate(args: argparse.Namespace) -> None:
    from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
    from wlr_render.studies.photo_sessions import simulate
    from wlr_render.studies.photo_sessions.making import Making
    from wlr_render.terminal import progress_bar

    bench = PhotoBenchOptions(
        camera_px=args.camera,
        bits=args.bits,
        pupil_mm=args.pupil_mm,
        focus_m=args.focus_m,
        snr=args.snr,
        target_depths_m=tuple(args.depths_m),
        stage_error_um=args.stage_error_um,
        seed=args.seed,
    )
    making = Making(args.device, args.eye, args.viewpoints, args.pattern, bench)
    made = simulate.run(args.session, making, args.workers, progress_bar)
    say(f"{made.taken} photographs taken, {made.kept} kept from an earlier run: {made.folder}")
    say(f"Next: wlr-render calibrate {made.folder}")


def _add_verify(verbs: Verbs) -> None:
    text = (
        "the on-device experiment: draw the target over itself, photograph it with the display off and on, and say in "
        "arcminutes how far the drawn dots lie from the real ones"
    )
    parser = new_verb(verbs, "verify", _verify, text)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "session", metavar="SESSION", type=Path, nargs="?", help="a simulated session: its bench is used again"
    )
    source.add_argument(
        "--pairs",
        metavar="FOLDER",
        type=Path,
        help="photographs of your own instead: NAME_off.png, and NAME_on.png or NAME_on_METHOD.png from the same place",
    )
    parser.add_argument("--board", metavar="FILE", type=Path, help="with --pairs: the target's board.toml")
    parser.add_argument(
        "--calibration", type=Path, default=Path("out/calibrate"), help="folder of the results of `calibrate SESSION`"
    )
    parser.add_argument("--viewpoints", type=count, default=5, help="camera places in the eye box")
    parser.add_argument("--depths-m", type=not_negative, nargs="+", default=[0.5, 0.8], help="where the target stands")
    parser.add_argument(
        "--workers", type=count, help="processes; one per core, but not more than memory allows, if not given"
    )
    add_seed(parser)
    add_backend(parser)


def _verify(args: argparse.Namespace) -> None:
    from wlr_render.errors import BadInputError
    from wlr_render.studies.verification import verify
    from wlr_render.terminal import print_table, progress_bar

    if args.pairs is not None:
        if args.board is None:
            raise BadInputError("--board is missing: which board.toml is that of the target in the photographs?")
        result = verify.run_pairs(args.pairs, args.board, args.calibration, args.out)
    else:
        result = verify.run(_verification(args), args.workers, progress_bar)
    for table in result.tables:
        print_table(table)
    say("Written: " + ", ".join(str(path) for path in result.files))


def _verification(args: argparse.Namespace) -> "verify.Options":
    from wlr_render.studies.verification import verify

    return verify.Options(
        args.session, args.calibration, args.out, args.viewpoints, tuple(args.depths_m), args.seed, args.backend
    )


def _add_board(verbs: Verbs) -> None:
    text = "a two-size dot board to be printed: SVG and PNG to scale, and the file that tells calibration of it"
    parser = new_verb(verbs, "board", _board, text)
    parser.add_argument("--columns", type=count, default=36, help="of dots")
    parser.add_argument("--rows", type=count, default=24, help="of dots")
    parser.add_argument("--pitch-mm", type=not_negative, default=20.0, help="distance of neighbouring dots")
    parser.add_argument("--dpi", type=count, default=200, help="of the PNG")
    add_seed(parser)


def _board(args: argparse.Namespace) -> None:
    from wlr_render.studies import targets

    for path in targets.write_board(args.out, args.columns, args.rows, 1e-3 * args.pitch_mm, args.dpi, args.seed):
        say(path)


def _add_pattern(verbs: Verbs) -> None:
    text = "the pictures of a panel code, and a page that shows them full screen, one pixel a pixel"
    parser = new_verb(verbs, "pattern", _pattern, text)
    _add_code(parser, required=True)


def _pattern(args: argparse.Namespace) -> None:
    from wlr_render.studies import targets

    count_of, page = targets.write_pattern(args.out, args.panel, args.pattern)
    say(f"{count_of} pictures; to show them, open {page} on the panel's screen")


def _add_decode(verbs: Verbs) -> None:
    text = (
        "decode photographs of a panel or projector that shows a code; says what was rejected and how good the rest is"
    )
    parser = new_verb(verbs, "decode", _decode, text)
    parser.add_argument(
        "photographs", metavar="FOLDER", type=Path, help="one photograph a picture, in order of showing"
    )
    _add_code(parser, required=False)
    parser.add_argument("--bits", type=int, choices=range(8, 17), default=8, metavar="8..16", help="of the camera")
    parser.add_argument("--from", dest="origin", choices=("own", "procam-graycode"), default="own", help="whose set")


def _decode(args: argparse.Namespace) -> None:
    from wlr_render.captures.patterns.catalogue import make_pattern
    from wlr_render.captures.patterns.pattern import DecodeOptions
    from wlr_render.errors import BadInputError
    from wlr_render.mappings import Panel
    from wlr_render.studies import decode_codes
    from wlr_render.terminal import print_table

    if args.origin == "procam-graycode":
        codes = decode_codes.of_procam_graycode(args.photographs)
    elif args.panel is None:
        raise BadInputError("--panel is missing: how many pixels has the panel that showed the code, e.g. 1920x1080?")
    else:
        codes = decode_codes.in_folder(args.photographs, make_pattern(args.pattern, Panel(*args.panel)))
    result = decode_codes.run(codes, args.out, DecodeOptions(2**args.bits - 1))
    for table in result.tables:
        print_table(table)
    say("Written: " + ", ".join(str(path) for path in result.files))


def _add_code(parser: argparse.ArgumentParser, required: bool) -> None:
    parser.add_argument(
        "--panel", type=size, required=required, metavar="WxH", help="the panel's pixels, e.g. 1920x1080"
    )
    parser.add_argument(
        "--pattern", choices=("gray", "fringes", "gray-fringes"), default="gray-fringes", help="the code"
    )


ADDED_BY = (_add_board, _add_pattern, _add_simulate, _add_decode, _add_verify)
"""One function a verb, in the order in which help lists them."""
