"""Read and write session.toml of a photographic session (docs/photo-session.md has the format)."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from wlr_render.captures.boards.board_file import load_board
from wlr_render.captures.camera_lens_file import KIND_OF_COUNT, lens_of_opencv, load_lens, require_plausible_lens
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.catalogue import PATTERNS, make_pattern, pattern_keys
from wlr_render.captures.photo_session import (
    CAMERA_POSE,
    CHANNELS,
    FAR_MM,
    GAUGE,
    POSE_SIGMA,
    CodeTable,
    GivenPose,
    PhotoSession,
    SessionCamera,
    SessionPanel,
)
from wlr_render.captures.photo_session_checks import check_count, check_session
from wlr_render.captures.photo_session_entries import (
    EntryFormat,
    place_names,
    read_stage,
    rounded,
    stage_lists,
    with_places,
    written_stage,
)
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import photographs_in
from wlr_render.errors import BadInputError
from wlr_render.geometry.transforms import FRAMES
from wlr_render.io.atomic_files import resource
from wlr_render.io.file_records import MM, Place, read_part, read_record, record_keys
from wlr_render.io.input_files import LIMITS, prefix_errors, require_eye_box, require_pixels
from wlr_render.io.toml_files import Table, read_toml, stated, write_toml
from wlr_render.lenses.lens_camera import LENS_KINDS, OPENCV_PIXEL_SHIFT, LensCamera
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray

FILE = "session.toml"
FORMAT = "photo-session"
VERSION = 1
EYES = ("left", "right")
_EYE_BOX_LEAST_MM = 0.5  # least size; a smaller one is in metres
_MOST_SIGMA = 1e6  # largest sigma; it means that nothing is known
_SOURCES = ("intrinsics", "focal_px", "lens_file")
Value = TypeVar("Value")


def load_photo_session(folder: str | Path) -> PhotoSession:
    """Read the session.toml of a folder; the photographs themselves are not opened.

    Raises:
        BadInputError: the file is missing or breaks the format, its lengths cannot be millimetres, or it contradicts
            itself; the message names the key.
    """
    root = Path(folder)
    if not (root / FILE).is_file():
        if (root / "bench.toml").is_file():
            raise BadInputError(
                f"{root}: is a bench session, not a photographic session; run `wlr-render calibrate {root}`."
            )
        manual = resource("docs", "photo-session.md")
        raise BadInputError(f"{root}: has no {FILE}, so it is not a photographic session; {manual} has the format.")
    file = read_toml(root / FILE)
    file.check_head(FORMAT, VERSION)
    file.check_unit("a session")
    axes = FRAMES[file.text("frame", choices=sorted(FRAMES))]
    device, eyes = file.text("device"), _eyes(file)
    panels, decoding, code = _panels(file, root, eyes)
    eyeball_table = file.table("eyeball_camera")
    eyeball = read_camera(eyeball_table, root)
    eyeball_table.finish()
    tracking, device_from_tracking, tracking_sigma = _tracking_camera(file, root, axes)
    stage, tolerance = read_stage(file, axes)
    form = EntryFormat(root, axes, eyes=eyes, stage=stage)
    session = PhotoSession(
        folder=root,
        device=device,
        eyes=eyes,
        eye_boxes=_of_each_eye(file, "eye_box", eyes, lambda table: _eye_box(table, axes), alike=False),
        panels=panels,
        decoding=replace(decoding, full_scale=eyeball.format.full_scale),
        board=load_board(file.path("board", root)),
        eyeball_camera=eyeball,
        see_through=form.photographs(file, "see_through"),
        display=form.code_sets(file),
        bare=form.photographs(file, "bare"),
        beside=form.photographs(file, "beside"),
        tracking=form.photographs(file, "tracking"),
        tracking_camera=tracking,
        device_from_tracking=device_from_tracking,
        tracking_sigma=tracking_sigma,
        stage=stage,
        targets=_targets(file, root, axes),
        gauge=GAUGE.read(file, Place()) if file.has("gauge") else None,
        code=code,
        place_tolerance=tolerance,
    )
    file.finish()
    check_count(file, session)
    regions = {each.path: each.regions for each in session.beside}
    through = tuple(replace(each, other_regions=regions.get(each.path)) for each in session.see_through)
    session = with_places(replace(session, see_through=through), form)
    check_session(file, session)
    return session


def _eyes(file: Table) -> tuple[str, ...]:
    if not file.has("eyes"):
        return (file.text("eye", choices=EYES),)
    if file.has("eye"):
        raise file.fail("give either 'eye' or 'eyes', not both.")
    eyes = file.texts("eyes")
    if len(set(eyes)) < len(eyes) or not set(eyes) <= set(EYES):
        raise file.fail(f'\'eyes\' is {eyes}; it must hold "left", "right", or both.')
    return tuple(eyes)


def _of_each_eye(
    file: Table, key: str, eyes: Sequence[str], read: Callable[[Table], Value], alike: bool = True
) -> dict[str, Value]:
    """Read the tables [key.left] and [key.right], or [key] for one eye, or for both eyes if `alike` is True."""
    table = file.table(key)
    if any(table.has(eye) for eye in eyes):
        values = {eye: read(table.table(eye)) for eye in eyes}
        table.finish()
        return values
    if len(eyes) > 1 and not alike:
        raise file.fail(f"[{key}] is one table for both eyes; give [{key}.left] and [{key}.right].")
    return dict.fromkeys(eyes, read(table))


def _panels(file: Table, root: Path, eyes: Sequence[str]) -> tuple[dict[str, SessionPanel], DecodeOptions, CodeTable]:
    """Return the panels, and the decoding thresholds and other keys of [code]."""
    sizes = _of_each_eye(file, "panel", eyes, _panel)
    table = file.table("code")
    name = table.text("pattern", choices=list(PATTERNS))
    numbers = {key: table.whole(key, 1, LIMITS.picture_side) for key in pattern_keys(name) if table.has(key)}
    decoding, code = read_part(DecodeOptions, table), read_record(CodeTable, table, Place(root))
    with prefix_errors(table.where):
        made = {id(size): SessionPanel(make_pattern(name, size[0], **numbers), size[1]) for size in sizes.values()}
    return {eye: made[id(size)] for eye, size in sizes.items()}, decoding, code


def _panel(table: Table) -> tuple[Panel, dict[str, FloatArray]]:
    panel = read_part(Panel, table)
    require_pixels(table.where, (panel.width_px, panel.height_px), "correct 'width_px' and 'height_px'")
    offsets: dict[str, FloatArray] = {}
    if table.has("primary_offsets_px"):
        given = table.table("primary_offsets_px")
        # A primary lies within its pixel.
        offsets = {channel: given.vector(channel, 2, least=-1, most=1) for channel in CHANNELS if given.has(channel)}
        given.finish()
    table.finish()
    return panel, offsets


def _eye_box(table: Table, axes: FloatArray) -> EyeBox:
    centre = table.vector("centre_mm", 3, least=-FAR_MM, most=FAR_MM)
    size = table.vector("size_mm", 3, least=_EYE_BOX_LEAST_MM)
    table.finish()
    require_eye_box(f"{table.where}: 'size_mm'", size, "mm")
    return EyeBox(MM * axes @ centre, MM * size)


def _tracking_camera(
    file: Table, root: Path, axes: FloatArray
) -> tuple[SessionCamera | None, FloatArray | None, tuple[float, float] | None]:
    if not file.has("tracking_camera"):
        return None, None, None
    table, place = file.table("tracking_camera"), Place(axes=axes)
    camera, pose = read_camera(table, root), CAMERA_POSE.read(table, place)
    sigma = POSE_SIGMA.read(table, place) if any(map(table.has, POSE_SIGMA.names)) else None
    table.finish()
    return camera, pose, sigma


def _targets(file: Table, root: Path, axes: FloatArray) -> dict[int, GivenPose]:
    targets: dict[int, GivenPose] = {}
    for table in file.tables("target", required=False):
        pose = table.whole("pose", most=LIMITS.index)
        if pose in targets:
            raise table.fail(f"target pose {pose} is given twice; remove one.")
        board = load_board(table.path("board", root)) if table.has("board") else None
        targets[pose] = read_record(GivenPose, table, Place(axes=axes), board=board)
    return targets


def save_photo_session(session: PhotoSession, code: dict[str, Any], board: str) -> Path:
    """Write session.toml in the axes "opencv" into the session's folder; `load_photo_session` reads it back.

    Args:
        session: session whose paths lie below its folder.
        code: content of the table [code]: `pattern` and its parameters.
        board: name of the board's file in the folder.
    """
    axes, is_one_eye = FRAMES["opencv"], len(session.eyes) == 1
    place = Place(axes=axes)
    boxes = {
        eye: {"centre_mm": rounded(axes.T @ box.centre / MM), "size_mm": rounded(box.size / MM)}
        for eye, box in session.eye_boxes.items()
    }
    panels = {eye: _written_panel(panel) for eye, panel in session.panels.items()}
    one_panel = len({id(panel) for panel in session.panels.values()}) == 1
    tracking = None
    if session.tracking_camera is not None and session.device_from_tracking is not None:
        tracking = written_camera(session.tracking_camera, session.folder)
        tracking |= CAMERA_POSE.keys(session.device_from_tracking, place)
        tracking |= POSE_SIGMA.keys(session.tracking_sigma, place) if session.tracking_sigma else {}
    targets = [{"pose": pose} | record_keys(each, place) for pose, each in session.targets.items()]
    content = stated(
        format=FORMAT,
        version=VERSION,
        unit="mm",
        frame="opencv",
        device=session.device,
        eye=session.eye if is_one_eye else None,
        eyes=None if is_one_eye else list(session.eyes),
        board=board,
        gauge=session.gauge,
        panel=panels[session.eyes[0]] if one_panel else panels,
        code=code | record_keys(session.code, Place(session.folder)),
        eye_box=boxes[session.eye] if is_one_eye else boxes,
        eyeball_camera=written_camera(session.eyeball_camera, session.folder),
        tracking_camera=tracking,
        stage=written_stage(session, axes) or None,
        target=targets or None,
        **_written_entries(session, EntryFormat(session.folder, axes, eyes=session.eyes, stage=session.stage)),
    )
    return write_toml(session.folder / FILE, content, "docs/photo-session.md has the format")


def _written_entries(session: PhotoSession, form: EntryFormat) -> dict[str, Any]:
    """Return the lists of photographs, with only those position names that stage readings do not imply."""
    entries = [(name, entry) for name, listed in stage_lists(session).items() for entry in listed]
    unnamed = [entry if session.stage is None else replace(entry, place="") for _, entry in entries]
    written: dict[str, list[dict[str, Any]]] = {name: [] for name in stage_lists(session)}
    for (name, entry), derived in zip(entries, place_names(unnamed, form, session.place_tolerance), strict=True):
        place = entry.place if session.stage is None or entry.place != derived else None
        written[name].append(form.written(entry, place))
    written["tracking"] = [form.written(entry, None, on_stage=False) for entry in session.tracking]
    return {name: listed for name, listed in written.items() if listed}


def _written_panel(panel: SessionPanel) -> dict[str, Any]:
    offsets = {channel: offset.tolist() for channel, offset in panel.primary_offsets.items()}
    return record_keys(panel.pattern.panel) | stated(primary_offsets_px=offsets or None)


def read_camera(table: Table, folder: Path) -> SessionCamera:
    """Read the keys of a camera; other keys of its table are left to the caller.

    Args:
        table: [eyeball_camera] or [tracking_camera].
        folder: folder of the session.

    Raises:
        BadInputError: a key is missing, faulty or contradicts another; the message names it.
    """
    size, form = (table.whole("width_px", 1), table.whole("height_px", 1)), PhotographFormat.from_table(table, folder)
    require_pixels(table.where, size, "correct 'width_px' and 'height_px'")
    lens = table.text("lens", "auto", ("auto", *LENS_KINDS))
    if sum(table.has(key) for key in _SOURCES) != 1:
        raise table.fail(
            "give either 'intrinsics', a folder of pictures of the board, or 'focal_px' and 'opencv_centre_px', or "
            "'lens_file', a calibration by another program."
        )
    if table.has("intrinsics"):
        return SessionCamera(size, form, tuple(photographs_in(table.path("intrinsics", folder))), lens=lens)
    if table.has("lens_file"):
        file = table.path("lens_file", folder)
        calibrated = load_lens(file)
        if table.has("lens"):
            raise table.fail("'lens' is given as well as 'lens_file', which states the kind of lens; remove 'lens'.")
        if calibrated.size_px != size:
            raise table.fail(
                f"its pictures have {_by(size)} pixels, but the lens in {file} was calibrated for "
                f"{_by(calibrated.size_px)}; give a lens of this size."
            )
    else:
        file, calibrated = None, _stated_camera(table, size, lens)
    return SessionCamera(
        size, form, calibrated=calibrated, calibrated_sigma=_sigma(table, len(calibrated.values)), lens_file=file
    )


def _by(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"


def _stated_camera(table: Table, size: tuple[int, int], lens: str) -> LensCamera:
    """Return the camera stated in a table; the number of distortion terms determines the kind of an "auto" lens."""
    core = np.concatenate([table.vector("focal_px", 2, above=0), table.vector("opencv_centre_px", 2)])
    terms = table.numbers("distortion") if table.has("distortion") else np.zeros(0)
    if lens == "auto":
        if len(terms) == 4:
            raise table.fail('\'distortion\' has 4 terms; state their kind by lens = "brown" or lens = "fisheye".')
        lens = KIND_OF_COUNT.get(len(terms), "brown")
    wanted = len(LENS_KINDS[lens])
    if len(terms) not in {0, 4, wanted}:
        raise table.fail(
            f"'distortion' has {len(terms)} terms, but a lens of kind '{lens}' has {wanted}: "
            f"{', '.join(LENS_KINDS[lens])}."
        )
    camera = lens_of_opencv(size, core, terms, lens)
    require_plausible_lens(table.where, camera)
    return camera


def _sigma(table: Table, count: int) -> FloatArray | None:
    """Return the standard deviations (count,) of fx, fy, cx, cy and the distortion; None if not stated."""
    several = [key for key in ("focal_sigma_px", "centre_sigma_px") if table.has(key)]
    if table.has("sigma") and several:
        raise table.fail(f"give either 'sigma' or '{several[0]}', not both.")
    if table.has("sigma"):
        sigma = table.vector("sigma", count, least=0, most=_MOST_SIGMA)
    elif several:
        focal, centre = (table.number(f"{name}_sigma_px", least=0, most=_MOST_SIGMA) for name in ("focal", "centre"))
        sigma = np.array([focal, focal, centre, centre, *[0.0] * (count - 4)])
    else:
        return None
    if not np.any(sigma):
        raise table.fail("one standard deviation must be above 0; leave them out for an exact lens.")
    return sigma


def written_camera(camera: SessionCamera, folder: Path) -> dict[str, Any]:
    """Return the keys of a camera that `read_camera` reads back."""
    keys = {"width_px": camera.size_px[0], "height_px": camera.size_px[1]} | camera.format.keys()
    keys |= stated(sigma=None if camera.calibrated_sigma is None else camera.calibrated_sigma.tolist())
    if camera.lens_file is not None:
        return keys | {"lens_file": str(camera.lens_file.relative_to(folder))}
    lens = camera.calibrated
    if lens is None:
        pictures = str(camera.intrinsics[0].parent.relative_to(folder))
        return keys | stated(lens=None if camera.lens == "auto" else camera.lens, intrinsics=pictures)
    if not isinstance(lens, LensCamera):
        raise TypeError(f"a {type(lens).__name__} is written as its 'lens_file' only")
    return keys | stated(
        lens=None if lens.kind == "brown" else lens.kind,
        focal_px=lens.focal_px.tolist(),
        opencv_centre_px=(lens.centre_px + OPENCV_PIXEL_SHIFT).tolist(),
        distortion=lens.distortion.tolist(),
    )
