"""The paper's figures, drawn from traced devices: rays of a pixel, sampling, bundles, two target planes, pupil swim."""

from functools import lru_cache

import numpy as np

from benchmarks.paper.drawings import (
    ABOVE,
    BLUE,
    BROWN,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    RED,
    SIDE,
    Diagram,
    display_path,
    drawing,
    optics_of,
    see_through_path,
)
from benchmarks.trials import EvaluatedEye, capture_setup, truth
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, normalised, tangents_of_dir
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device_file import load_device
from wlr_render.report.blocks import Block, Cell, Plot, ReportTable
from wlr_render.report.plots import arrow_map
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions, design_photo_bench

POSITIONS = 25
"""Number of camera positions in the figures of sampling."""
OBJECT_M = 0.25
"""Depth of the object in drawings: near, so that the headset stays visible."""
TARGETS_M = (0.2, 0.4)
"""Depths of the two target planes in the drawing of the procedure."""
MOVES_MM = {"3 mm right": (3.0, 0.0, 0.0), "3 mm up": (0.0, 3.0, 0.0), "3 mm back": (0.0, 0.0, 3.0)}
_SWIM_GRID = (11, 9)
_BEHIND_M = 0.008  # distance before and behind the base plane to which rays are drawn
_FACING = np.array([0.0, 0.0, 1.0])  # normal of an upright target


def field_directions(eye: EvaluatedEye, columns: int, rows: int) -> FloatArray:
    """Return a grid of directions (n, 3) within the evaluated field, without its edge."""
    field = capture_setup(eye).field
    tx, ty = (np.linspace(field.low[k], field.high[k], n + 2)[1:-1] for k, n in enumerate((columns, rows)))
    return dir_of_tangents(np.stack(np.meshgrid(tx, ty), axis=-1).reshape(-1, 2))


@lru_cache
def one_pixel(eye: EvaluatedEye) -> Plot:
    """Draw a pixel's ray from panel to viewpoint, and the ray of the same direction to an object (figure 2)."""
    optics, centre = optics_of(eye), truth(eye).eye_box.centre[None]
    view_dir = field_directions(eye, 3, 3)[[1]]
    shown = display_path(optics, centre, view_dir)
    world = see_through_path(optics, centre, view_dir, (centre[0] - [0.0, 0.0, OBJECT_M], _FACING))
    straight = np.stack([centre, centre + view_dir * (OBJECT_M / -view_dir[:, 2:])], axis=1)
    diagrams = [
        Diagram(view, view.title)
        .optics(optics)
        .eye_box(optics, eye.eye_box_mm)
        .lines("straight on", straight, GREY, dash="dot")
        .lines("display ray: pixel to viewpoint", shown, RED, width=2.5)
        .lines("see-through ray: viewpoint to object", world, BLUE, width=2.5)
        .points("object", world[:, -1], BLUE, symbol="square", size=10)
        for view in (SIDE, ABOVE)
    ]
    caption = (
        "The pixel must show the point that the see-through ray of the same direction hits. In this drawing the object "
        f"is {1e3 * OBJECT_M:g} mm away."
    )
    return drawing(f"Figure 2: one pixel's ray, {eye}", diagrams, caption)


@lru_cache
def sampling(eye: EvaluatedEye) -> Plot:
    """Draw camera positions of volumetric and planar sampling with rays of three pixels (figure 4)."""
    optics, setup = optics_of(eye), capture_setup(eye)
    mapping = setup.truth.display
    pixel = mapping.pixel_of_view_dir(field_directions(eye, 3, 1), setup.truth.eye_box.centre).value
    diagrams = []
    for kind in ("volumetric", "planar"):
        position = setup.camera_positions(kind, POSITIONS)
        view_dir = mapping.view_dir_of_pixel(pixel[:, None], position).value
        ray = np.stack([position + _BEHIND_M * view_dir, np.broadcast_to(position, view_dir.shape)], axis=-2)
        diagram = Diagram(ABOVE, f"{kind}: {POSITIONS} camera positions").eye_box(optics, eye.eye_box_mm)
        for name, colour, lines in zip(("left", "middle", "right"), (RED, ORANGE, BLUE), ray, strict=True):
            diagram.lines(f"rays of a pixel on the {name}", lines, colour, width=1)
        diagrams.append(diagram.points("camera position", position, GREY))
    caption = (
        "Planar sampling reaches beyond the eye box' sides, because rays through its front and back cross the base "
        "plane there."
    )
    return drawing(f"Figure 4: volume against plane sampling, {eye}", diagrams, caption)


def crossings(eye: EvaluatedEye, half_mm: float = 4.0) -> FloatArray:
    """Return points (9, 3) of the base plane, which lies in the middle of the eye box."""
    grid = np.linspace(-1e-3 * half_mm, 1e-3 * half_mm, 3)
    x, y = (each.ravel() for each in np.meshgrid(grid, grid))
    return truth(eye).eye_box.centre + np.stack([x, y, np.zeros_like(x)], axis=-1)


def viewpoints_on_rays(eye: EvaluatedEye, crossing: FloatArray, view_dir: FloatArray) -> FloatArray:
    """Return five viewpoints (n, 5, 3) on each ray through `crossing` (n, 3), from front to back of the eye box."""
    depth = 0.5e-3 * eye.eye_box_mm[2] * np.linspace(-1.0, 1.0, 5)
    return np.asarray(crossing[:, None] - (depth[:, None] / -view_dir[:, None, 2:]) * view_dir[:, None])


@lru_cache
def display_bundle(eye: EvaluatedEye) -> Plot:
    """Draw rays of one pixel, viewpoints on them, and their crossings of the base plane (figure 6a)."""
    mapping, at = truth(eye).display, crossings(eye)
    pixel = mapping.pixel_of_view_dir(field_directions(eye, 3, 3)[4], truth(eye).eye_box.centre).value
    view_dir = mapping.view_dir_of_pixel(pixel, at).value
    viewpoint = viewpoints_on_rays(eye, at, view_dir)
    seen = mapping.view_dir_of_pixel(pixel, viewpoint).value
    path = display_path(optics_of(eye), at - _BEHIND_M * view_dir, view_dir)
    return _bundle_drawing("Figure 6a: bundle of one display pixel", "the pixel", eye, path, viewpoint, view_dir, seen)


@lru_cache
def see_through_bundle(eye: EvaluatedEye) -> Plot:
    """Draw view rays of one real point, viewpoints on them, and their crossings of the base plane (figure 6b)."""
    optics, mapping, at = optics_of(eye), truth(eye).see_through, crossings(eye)
    centre = truth(eye).eye_box.centre[None]
    target = centre[0] - [0.0, 0.0, OBJECT_M], _FACING
    point = see_through_path(optics, centre, field_directions(eye, 3, 3)[[4]], target)[:, -1]
    view_dir = mapping.view_dir_of_real_point(point, at).value
    viewpoint = viewpoints_on_rays(eye, at, view_dir)
    seen = mapping.view_dir_of_real_point(point, viewpoint).value
    path = see_through_path(optics, at - _BEHIND_M * view_dir, view_dir, target)
    return _bundle_drawing("Figure 6b: bundle of one real point", "the point", eye, path, viewpoint, view_dir, seen)


def _bundle_drawing(
    title: str, subject: str, eye: EvaluatedEye, path: FloatArray, viewpoint: FloatArray, *dirs: FloatArray
) -> Plot:
    optics, at, (view_dir, seen) = optics_of(eye), crossings(eye), dirs
    near = np.stack([at + _BEHIND_M * view_dir, at - _BEHIND_M * view_dir], axis=1)
    differs = float(np.nanmax(np.linalg.norm(seen - view_dir[:, None], axis=-1))) / ARCMIN
    diagrams = [
        Diagram(ABOVE, name)
        .eye_box(optics, eye.eye_box_mm)
        .lines(f"rays of {subject}", lines, RED, width=1)
        .points("viewpoints on them", viewpoint, ORANGE, size=6)
        .points("crossings of the base plane", at, GREEN, size=8)
        for name, lines in (("whole path", path), ("at the eye box", near))
    ]
    diagrams[0].optics(optics)
    caption = (
        f"Traced viewpoints on one line see {subject} in directions that differ by at most {differs:.0e} arcmin. The "
        "crossing of the base plane represents all of them."
    )
    return drawing(f"{title}, {eye}", diagrams, caption)


@lru_cache
def two_planes(eye: EvaluatedEye) -> Plot:
    """Draw the four steps of the calibration with two target planes (figure 9) on the simulated bench."""
    optics = optics_of(eye)
    bench = design_photo_bench(load_device(eye.device), eye.eye, PhotoBenchOptions(target_depths_m=TARGETS_M))
    centre, tracking = truth(eye).eye_box.centre, bench.device_from_tracking[:3, 3]
    half = 0.3 * bench.board.size_m[1]
    dots, boards = [], []
    for pose in bench.device_from_target:
        on_board = np.stack([np.zeros(3), half * np.array([-1.0, 0.0, 1.0]), np.zeros(3)], axis=-1)
        dots.append(on_board @ pose[:3, :3].T + pose[:3, 3])
        boards.append((1.25 * on_board @ pose[:3, :3].T + pose[:3, 3])[None])
    position = centre + 1e-3 * np.array([[0.0, y, 0.0] for y in (-4.0, 0.0, 4.0)])
    view_dir = np.tile(field_directions(eye, 1, 3), (3, 1))
    where = np.repeat(position, 3, axis=0)
    targets = [(pose[:3, 3], pose[:3, 2]) for pose in bench.device_from_target]
    near, far = (see_through_path(optics, where, view_dir, target) for target in targets)
    names = ("target plane P+", "target plane P-")

    def diagram(title: str, *target: int) -> Diagram:
        made = Diagram(SIDE, title)
        for number in target:
            made.lines(names[number], boards[number], (ORANGE, BROWN)[number], width=4)
        return made

    def lines_from(start: FloatArray, ends: FloatArray) -> FloatArray:
        return np.stack([np.broadcast_to(start, ends.shape), ends], axis=1)

    camera, headset, seen = "eyeball camera", "headset's camera", "seen through the optics"
    diagrams = [
        diagram("a: target without headset", 0)
        .lines("seen directly", lines_from(centre, dots[0]), GREY)
        .points(camera, centre, GREY),
        diagram("b: headset on; its camera", 0)
        .optics(optics, panel=False)
        .lines("seen by the headset's camera", lines_from(tracking, dots[0]), GREEN)
        .points(headset, tracking, GREEN, symbol="square")
        .points(camera, centre, GREY),
        diagram("c: camera moved in the base plane", 0)
        .optics(optics, panel=False)
        .lines(seen, near, BLUE, width=1)
        .points("readings on P+", near[:, -1], RED, size=5)
        .points(camera, position, GREY),
        diagram("d: target moved, b and c again", 0, 1)
        .optics(optics, panel=False)
        .lines(seen, far, BLUE, width=1)
        .points("readings on P+", near[:, -1], RED, size=5)
        .points("readings on P-", far[:, -1], PURPLE, size=5)
        .points(camera, position, GREY),
    ]
    caption = (
        f"Targets stand {' and '.join(f'{1e3 * depth:g}' for depth in TARGETS_M)} mm away in this drawing. The two "
        "readings of one camera pixel give its world ray. The headset's camera sees past the combiner."
    )
    return drawing(f"Figure 9: calibration with two target planes, {eye}", diagrams, caption, height_px=760)


@lru_cache
def pupil_swim(eyes: tuple[EvaluatedEye, ...]) -> tuple[Block, ...]:
    """Draw the change of directions with the viewpoint: of a pixel (figure 3), and of a world ray (figure 7)."""
    rows: list[list[Cell]] = []
    maps: tuple[dict[str, tuple[FloatArray, FloatArray]], ...] = ({}, {})
    for eye in eyes:
        at, centre = truth(eye), truth(eye).eye_box.centre
        view_dir = field_directions(eye, *_SWIM_GRID)
        pixel = at.display.pixel_of_view_dir(view_dir, centre).value
        straight = at.see_through.real_ray_of_view_dir(view_dir, centre).value[:, 3:]
        place = np.rad2deg(np.arctan(tangents_of_dir(view_dir)))
        for name, move in MOVES_MM.items():
            moved = centre + 1e-3 * np.array(move)
            shown = at.display.view_dir_of_pixel(pixel, moved).value
            world = at.see_through.real_ray_of_view_dir(view_dir, moved).value[:, 3:]
            arrows = _change(view_dir, shown), _change(straight, world)
            for chosen, arrow in zip(maps, arrows, strict=True):
                chosen[f"{eye}, {name}"] = place, arrow
            sizes = [np.linalg.norm(arrow, axis=-1) for arrow in arrows]
            rows.append([str(eye), name, *(f(size) for size in sizes for f in (_rms, _largest))])
    axes = ("right (degrees)", "up (degrees)")
    columns = [f"{model}, {what} (arcmin)" for model in ("display", "see-through") for what in ("rms", "largest")]
    return (
        ReportTable("Pupil swim: change of direction when the viewpoint moves", ["eye", "viewpoint", *columns], rows),
        arrow_map(
            "Figure 3: pupil swim of the display",
            maps[0],
            "arcmin",
            axes,
            caption="Change of the direction in which a pixel is seen. A menu chooses eye and move.",
        ),
        arrow_map(
            "Figure 7: pupil swim of the see-through optics",
            maps[1],
            "arcmin",
            axes,
            caption="Change of the direction of the world ray of a view direction. A menu chooses eye and move.",
        ),
    )


def _change(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the change (n, 2) of directions (n, 3) to the right and up, arcminutes."""
    right = normalised(np.cross(first, [0.0, 1.0, 0.0]))
    up = np.cross(right, first)
    return np.stack([np.sum((second - first) * each, axis=-1) for each in (right, up)], axis=-1) / ARCMIN


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _largest(values: FloatArray) -> float:
    return float(np.nanmax(values))
