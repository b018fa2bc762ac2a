"""Checks that refuse contradictions and gaps in session.toml."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from wlr_render.captures.photo_session import PhotoSession, SessionEntry, StageDescription
from wlr_render.captures.photo_session_entries import place_groups, stage_lists
from wlr_render.io.input_files import LIMITS
from wlr_render.io.toml_files import Table

_MM = 1e-3
_TRAVEL_MM = (0.5, 500.0)  # range of plausible travel; outside it, the unit is metres or micrometres

Node = tuple[str, object]
_DEVICE: Node = ("device", None)


def check_count(file: Table, session: PhotoSession) -> None:
    """Refuse too many photographs: the search for positions takes memory quadratic in their number."""
    count = sum(len(listed) for listed in stage_lists(session).values()) + len(session.tracking)
    if count > LIMITS.photographs:
        raise file.fail(f"lists {count} photographs, more than {LIMITS.photographs}; split the session.")


def check_session(file: Table, session: PhotoSession) -> None:
    """Refuse a session whose photographs cannot be placed in the device frame, or that contradicts itself.

    Raises:
        BadInputError: it is not usable; the message has the key and the remedy.
    """
    _check_lists(file, session)
    _check_copies(file, session)
    _check_frame(file, session)
    _check_travel(file, session)
    _check_places(file, session)
    _check_regions(file, session)
    _check_links(file, session)


def _check_lists(file: Table, session: PhotoSession) -> None:
    if not session.see_through and not session.display:
        raise file.fail(
            "'see_through' and 'display' are both empty; a calibration needs photographs of at least one: list them as "
            "[[see_through]] or [[display]]."
        )
    of_optics: list[SessionEntry] = [*session.see_through, *session.display]
    for eye in session.eyes:
        if not any(each.eye == eye for each in of_optics):
            raise file.fail(f"there is no [[see_through]] and no [[display]] of the {eye} eye; add them, or its 'eye'.")
    if session.tracking_camera is not None and not session.tracking:
        raise file.fail(
            "'tracking' is empty; list the photographs of [tracking_camera] as [[tracking]], or remove that table."
        )
    if session.tracking_camera is None and session.tracking:
        raise file.fail("there are [[tracking]] photographs, but no [tracking_camera]; add that table.")


def _check_copies(file: Table, session: PhotoSession) -> None:
    """Refuse photographs that are listed twice: a fit would use them as independent measurements."""
    for name, entries in {**stage_lists(session), "tracking": session.tracking}.items():
        first: dict[tuple[object, ...], int] = {}
        for number, each in enumerate(entries, 1):
            # One photograph may show several targets, in a region each.
            regions = str(getattr(each, "regions", None))
            shown = each.path, each.eye, getattr(each, "channel", None), getattr(each, "target_pose", None), regions
            if (same := first.setdefault(shown, number)) != number:
                raise file.fail(f"[[{name}]] {number} is a copy of [[{name}]] {same}; remove it.")


def _check_frame(file: Table, session: PhotoSession) -> None:
    """Refuse a session in which nothing, or more than one thing, fixes the device frame."""
    fixed = {"[tracking_camera]": session.tracking_camera is not None, "[[target]]": bool(session.targets)}
    if session.gauge is None and not any(fixed.values()):
        raise file.fail(
            "nothing fixes the device frame: add [tracking_camera] with its pose and [[tracking]] photographs, or a "
            '[[target]] whose pose in the device you know (fiducials on the headset, say), or gauge = "target 0" for a '
            "calibration of the optics alone."
        )
    for name, given in fixed.items():
        if given and session.gauge is not None:
            raise file.fail(f"'gauge' and {name} both fix the device frame; remove one.")
    photographed = {each.target_pose for each in (*session.bare, *session.beside, *session.tracking)}
    for pose in (*session.targets, *([] if session.gauge_target is None else [session.gauge_target])):
        if pose not in photographed | {each.target_pose for each in session.see_through}:
            name = "'gauge'" if session.gauge else "[[target]]"
            raise file.fail(f"{name} names target pose {pose}, which has no photographs; correct the number.")
    if session.gauge == "camera" and session.stage is None:
        raise file.fail(
            'gauge = "camera" is the camera at the stage\'s reference, but there is no stage; name a target.'
        )


def _check_travel(file: Table, session: PhotoSession) -> None:
    if session.stage is None:
        return
    linear, (low, high) = [axis.kind == "linear" for axis in session.stage.axes], _TRAVEL_MM
    for name, entries in stage_lists(session).items():
        if entries:
            stage = np.array([each.stage for each in entries])[:, linear] / _MM
            travel = float(np.linalg.norm(np.ptp(stage, axis=0)))
            if travel and not low <= travel <= high:
                raise file.fail(
                    f"'stage_mm' (travel of [[{name}]]) should be between {low:g} and {high:g} mm and is {travel:.6g}: "
                    "is it in another unit? Lengths are millimetres."
                )


def _check_places(file: Table, session: PhotoSession) -> None:
    """Refuse a position with several stage readings or orientations."""
    entries = [entry for listed in stage_lists(session).values() for entry in listed]
    groups = _groups(entries, session.stage, session.place_tolerance)
    first: dict[str, int] = {}
    for number, entry in enumerate(entries):
        other = first.setdefault(entry.place, number)
        if groups[other] != groups[number]:
            one, two = (session.name_of(each.path) for each in (entries[other], entry))
            raise file.fail(
                f"place '{entry.place}' has entries of several stage readings or orientations ({one} and {two}); give "
                "them different places, or correct the readings."
            )


def _groups(entries: Sequence[SessionEntry], stage: StageDescription | None, tolerance_m: float) -> Sequence[int]:
    if stage is None:
        return [each.orientation for each in entries]
    return [int(group) for group in place_groups(entries, stage, tolerance_m)]


def _check_regions(file: Table, session: PhotoSession) -> None:
    pose_of: dict[Path, int] = {}
    for photograph in (*session.bare, *session.beside, *session.see_through, *session.tracking):
        other = pose_of.setdefault(photograph.path, photograph.target_pose)
        if other != photograph.target_pose:
            raise file.fail(
                f"{photograph.name} is listed with target poses {other} and {photograph.target_pose}; a photograph is "
                "read as one target: correct one of them, or copy the file under another name if it shows two boards."
            )
    through = {entry.path: entry for entry in session.see_through}
    width, height = session.eyeball_camera.size_px
    for number, entry in enumerate(session.beside, start=1):
        where = f"[[beside]] number {number}"
        if entry.regions is not None and np.any((entry.regions < 0) | (entry.regions > [width, height, width, height])):
            raise file.fail(f"{where}: 'region_px' lies outside the picture of {width} x {height} pixels; correct it.")
        if entry.path in through:
            if entry.regions is None:
                raise file.fail(
                    f"{where} is also a [[see_through]] photograph; say with 'region_px' which part of it sees the "
                    "target past the optics."
                )
            if entry.place != through[entry.path].place:
                raise file.fail(f"{where} is also a [[see_through]] photograph, of another place; correct one.")


def _check_links(file: Table, session: PhotoSession) -> None:
    """Refuse target poses and camera positions that nothing links to the device frame."""
    reachable = _reachable(session)
    for name, photographs in (("bare", session.bare), ("beside", session.beside), ("see_through", session.see_through)):
        for number, photograph in enumerate(photographs, start=1):
            if ("target", photograph.target_pose) not in reachable:
                raise file.fail(
                    f"[[{name}]] number {number} is of target pose {photograph.target_pose}, which has no "
                    "[[tracking]] photograph, no [[target]] pose and no chain of [[bare]] or [[beside]] photographs: "
                    "the position of that target is unknown."
                )
    entries: Sequence[SessionEntry]
    for name, entries in (("see_through", session.see_through), ("display", session.display)):
        for number, entry in enumerate(entries, start=1):
            if _camera(session, entry) not in reachable:
                raise file.fail(f"[[{name}]] number {number}: {_no_camera(session, entry)}")
    _check_axes(file, session)


def _reachable(session: PhotoSession) -> set[Node]:
    """Return the target poses, positions and orientations that photographs and poses link to the device frame."""
    links: list[tuple[Node, Node]] = [
        *((_DEVICE, ("target", each.target_pose)) for each in session.tracking),
        *((_DEVICE, ("target", pose)) for pose in session.targets),
        *((_camera(session, each), ("target", each.target_pose)) for each in (*session.bare, *session.beside)),
    ]
    if session.gauge_target is not None:
        links.append((_DEVICE, ("target", session.gauge_target)))
    elif session.gauge == "camera":
        lowest = min(each.orientation for listed in stage_lists(session).values() for each in listed)
        links.append((_DEVICE, ("camera", lowest)))
    reachable, before = {_DEVICE}, 0
    while len(reachable) > before:
        before = len(reachable)
        reachable |= {node for link in links if reachable.intersection(link) for node in link}
    return reachable


def _camera(session: PhotoSession, entry: SessionEntry) -> Node:
    """Return the node of the camera's pose: its orientation on the stage or, without a stage, its position."""
    return ("camera", entry.place if session.stage is None else entry.orientation)


def _no_camera(session: PhotoSession, entry: SessionEntry) -> str:
    if session.stage is None:
        return (
            f"the position of place '{entry.place}' is unknown; add a [[beside]] photograph of that place "
            "that shows a target of known pose past the optics."
        )
    empty = "" if session.bare else "'bare' is empty; "
    return (
        f"{empty}the camera's pose at orientation {entry.orientation} is unknown; add [[bare]] photographs of a "
        "target of known pose without the headset, or [[beside]] photographs past its optics."
    )


def _check_axes(file: Table, session: PhotoSession) -> None:
    """Refuse moving axes of unknown direction: neither stated nor shown by photographs not through the optics."""
    if session.stage is None or session.bare or session.beside:
        return
    of_optics: list[SessionEntry] = [*session.see_through, *session.display]
    travel = np.ptp([np.asarray(each.stage) for each in of_optics], axis=0)
    for number, axis in enumerate(session.stage.axes, start=1):
        if travel[number - 1] > session.place_tolerance and (
            axis.direction is None or (axis.kind == "rotary" and axis.pivot is None)
        ):
            wanted = "'direction' and 'pivot_mm'" if axis.kind == "rotary" else "'direction'"
            raise file.fail(
                f"stage axis {number} moves in an unknown direction: add [[bare]] or [[beside]] photographs of a "
                f"target, or give the axis its {wanted}."
            )
