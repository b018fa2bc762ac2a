"""Rays of a headset in other renderers: their hit points and speed, compared with Embree."""

import time
from dataclasses import KW_ONLY, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import numpy as np

from benchmarks.renderers.casting import BESIDE_M, LIBRARIES, Cast, blender_positions, right_distances
from benchmarks.speed.timing import ratio
from wlr_render.draw.mitsuba_frames import PathTracer
from wlr_render.draw.ray_intersections import SceneTracer
from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.jobs.headset import open_eye
from wlr_render.jobs.options import Options, ProgressArgument, Range, described
from wlr_render.numerics.arrays import Float32Array, FloatArray
from wlr_render.report.blocks import Cell, Report, ReportTable
from wlr_render.report.save import markdown, save_report
from wlr_render.scene.scene import Scene
from wlr_render.scene.scene_file import load_scene
from wlr_render.warp.ray_map import choose_plan, ray_map
from wlr_render.work.progress import SILENT

_MICROMETRE = 1e-6
_BOUNCES = 1


@dataclass(frozen=True)
class RenderersOptions(Options):
    """Options of `renderers`."""

    headset: Annotated[str, described("A device or a model file.")] = "northstar"
    _: KW_ONLY
    scenes: Annotated[tuple[str, ...], described("Scenes, one or more.", many=True)] = ("sculpture", "desk")
    rounds: Annotated[int, described("Timed rounds, in which renderer and Embree alternate."), Range(1, 1000)] = 9
    record: Annotated[Path | None, described("Folder in which renderers.md is kept, too.")] = None
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/renderers")


def run(options: RenderersOptions = RenderersOptions(), *, progress: ProgressArgument = SILENT) -> Report:
    """Compare the installed renderers; write renderers.html, .md and .json.

    Raises:
        BadInputError: no renderer is installed, or a file is faulty.
    """
    installed = [library for library in LIBRARIES if library.is_installed]
    if not installed and find_spec("bpy") is None:
        raise BadInputError("None of the renderers is installed; docs/renderers.md has the commands that install them.")
    eye = open_eye(options.headset)
    rays = ray_map(eye, eye.eye_box.centre, choose_plan(eye))
    origin, direction = rays.world_rays(np.eye(4))
    known = np.isfinite(direction).all(axis=1)
    tables = []
    for name in options.scenes:
        scene = load_scene(name)
        embree, chosen = SceneTracer(scene), (origin[known], direction[known])
        expected = right_distances(scene, *chosen)
        rows: list[list[Cell]] = [["Embree", *differences(embree.intersect(*chosen).distance, expected), None, None]]
        for library in installed:
            progress.say(f"{library.name}, {name}")
            cast = library.caster(scene)
            found = differences(cast(*chosen), expected)
            rows.append([library.name, *found, *_speed(cast, embree, chosen, options.rounds)])
            if library.module == "mitsuba":
                speed = _speed(_paths(scene), embree, chosen, options.rounds)
                rows.append([f"{library.name}, light by paths of {_BOUNCES + 2} rays", *[None] * len(found), *speed])
        if find_spec("bpy") is not None:
            progress.say(f"Blender, {name}")
            distance = along_ray(blender_positions(rays, np.eye(4), name)[known], *chosen)
            rows.append(["bpy (Cycles)", *differences(distance, expected), None, None])
        hit, at_edge = np.isfinite(expected[0]), (np.ptp(np.where(np.isfinite(expected), expected, 1e9), axis=0) > 0)
        title = f"{name}: {len(hit)} rays of {eye.name}; {hit.mean():.1%} hit, {at_edge.sum()} of them beside an edge"
        tables.append(ReportTable(title, _COLUMNS, rows, _NOTES))
    report = Report("Other renderers on a headset's rays", blocks=tables, record=options)
    if options.record is not None:
        write_text(options.record / "renderers.md", markdown(report, options.record))
    return save_report(report, output_folder(options.out), "renderers")


_COLUMNS = [
    "renderer",
    "other side of an edge",
    "hit in one only",
    "median (um)",
    "99.9 % (um)",
    "max (um)",
    "beyond 1 um",
    "Mrays per CPU second",
    "speed over Embree's",
]
_NOTES = [
    "Differences to the distance, in 64 bits, of the plane of the triangle that Embree hits (embreex, robust). For a "
    f"ray that passes an edge within {1e6 * BESIDE_M:g} um, to the nearer of the distances on its two sides; 'other "
    "side of an edge' counts rays that took another side than Embree, and the sides are more than 1 um apart.",
    "In 32 bits neighbouring numbers are 0.06 um apart near 0.7 m, and 0.24 um near 3 m. Cycles shades each pixel: its "
    "position pass is compared, not its speed.",
    "Speed: CPU time of all threads, from arrays to arrays; the ratio is the median of rounds in which both alternate.",
]


def differences(distance: Float32Array, expected: FloatArray) -> list[Cell]:
    """Tabulate a renderer's distances (n,) against `right_distances` (5, n).

    Returns:
        Number of rays on the other side of an edge than Embree's; number that disagree with both sides; median, 99.9 %
        quantile and maximum of the other rays' differences in um; number of rays beyond 1 um.
    """
    with np.errstate(invalid="ignore"):
        apart = np.abs(distance.astype(np.float64) - expected)
    apart[np.isinf(distance) & np.isinf(expected)] = 0.0
    off = apart.min(axis=0)
    one_only = np.isinf(off)
    found = off[~one_only & np.isfinite(distance)]
    quantiles = (
        [float(each / _MICROMETRE) for each in np.quantile(found, [0.5, 0.999, 1.0])] if found.size else [None] * 3
    )
    other_side = (apart[0] > _MICROMETRE) & (off < apart[0] - _MICROMETRE)
    return [int(other_side.sum()), int(one_only.sum()), *quantiles, int((found > _MICROMETRE).sum())]


def along_ray(position: Float32Array, origin: Float32Array, direction: Float32Array) -> Float32Array:
    """Return distances (n,) of points along unit rays; points at the world's origin mark misses and give infinity."""
    along = ((position.astype(np.float64) - origin) * direction).sum(axis=1)
    return np.where((position != 0).any(axis=1), along, np.inf).astype(np.float32)


def _paths(scene: Scene) -> Cast:
    tracer = PathTracer(scene, _BOUNCES)
    return lambda origin, direction: tracer.light(origin, direction, 0)


def _speed(cast: Cast, embree: SceneTracer, rays: tuple[Float32Array, Float32Array], rounds: int) -> list[Cell]:
    times = np.empty((rounds + 1, 2))
    for turn in times:
        for number, each in enumerate((cast, embree.intersect)):
            start = time.process_time()
            each(*rays)
            turn[number] = time.process_time() - start
    own, of_embree = times[1:].T
    return [float(len(rays[0]) / np.median(own) / 1e6), str(ratio(of_embree, own))]
