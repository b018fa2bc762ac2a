"""Report of a calibration from photographs: readings, uncertainty of the station, and fit of the models."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from wlr_render.calibration.bench.bench_blocks import EXACT
from wlr_render.calibration.bench.bench_checks import prior_pulls, reading_pulls
from wlr_render.calibration.bench.board_shape import BOARD_SHAPE
from wlr_render.calibration.calibrate_session import EyeCalibration, SessionCalibration
from wlr_render.calibration.poses import Pose
from wlr_render.captures.decoded import Rejection
from wlr_render.captures.photo_session import PhotoSession
from wlr_render.captures.session_reading import Excluded, Reading
from wlr_render.geometry.directions import ARCMIN
from wlr_render.io.atomic_files import write_figure
from wlr_render.jobs.calibrate.eye_tables import binocular_table, primaries_table
from wlr_render.jobs.calibrate.fit_findings import fit_advice, fit_blocks, fit_sentences
from wlr_render.jobs.decode import rejection_colours
from wlr_render.lenses.residual_lens import RESIDUAL, ResidualLens
from wlr_render.report.blocks import Block, Cell, Columns, Estimate, Number, Picture, ReportTable, Section, table

_ACROSS = 6  # number of small pictures side by side
_NAMED = 1e-4  # share of the picture above which a table names a reason of rejection


def headline(found: SessionCalibration) -> str:
    """Summarise the readings, the result and the checks."""
    off = sum(not check.ok for check in found.bench.checks)
    checks = f"{off} check(s) of the bench failed" if off else "every check of the bench passed"
    fits = [fit_sentences(each.kinds) for each in found.eyes.values()]
    if len(fits) > 1:
        fits = [f"{eye.capitalize()} eye: {fit}" for eye, fit in zip(found.eyes, fits, strict=True)]
    return (
        f"{' '.join(fits)} {len(found.reading.boards)} photographs of the board and "
        f"{len(found.reading.panels)} sets of the panel were read, {len(found.all_excluded)} excluded; {checks}."
    )


def advice(found: SessionCalibration) -> list[str]:
    """Return the next steps: faults and failed checks first, then camera positions to add."""
    steps = [
        "Compare the excluded photographs with their entries in session.toml; correct these, or take them again."
    ] * bool(found.faults)
    steps += [f"{check.step}: {check.sentence}" for check in found.bench.checks if not check.ok]
    return [*steps, *(step for each in found.eyes.values() for step in fit_advice(each.fit))]


def set_names(found: SessionCalibration, eye: EyeCalibration) -> list[str]:
    """Return the names of an eye's photographed panel sets, by number of the display's capture."""
    return [found.session.name_of(each.folder) for each, _ in found.reading.panels_of(eye.session.display)]


def session_blocks(found: SessionCalibration, folder: Path) -> list[Block]:
    """Return tables, pictures (written into `folder`) and plots, in the order of the procedure."""
    blocks: list[Block] = [
        *reading_blocks(found.session, found.reading, found.all_excluded),
        *(_coverage(folder, each, len(found.session.eyes) > 1) for each in found.eyes.values()),
        *_decoding(folder, found),
        Section("The bench"),
        _lens_table(found),
        *_kinds_tables(found),
        _poses_table(found),
        _errors_table(found),
        _chi_squared_table(found),
        _checks_table(found),
    ]
    if len(found.eyes) > 1:
        blocks += [Section("Both eyes"), binocular_table(found)]
    for eye, each in found.eyes.items():
        blocks.append(Section("The models" if len(found.session.eyes) == 1 else f"The models of the {eye} eye"))
        blocks += fit_blocks(each.kinds, each.captures, set_names(found, each))
        blocks += [primaries_table(each)] if each.primaries else []
    return blocks


def reading_blocks(session: PhotoSession, reading: Reading, excluded: Iterable[Excluded]) -> list[Block]:
    """Return tables of the readings and of the exclusions."""
    tables = [_read_table(session, reading), _excluded_table(excluded), _decoded_table(session, reading)]
    return [Section("Photographs"), *(table for table in tables if table.rows)]


def _decoding(folder: Path, found: SessionCalibration) -> list[Picture]:
    if not found.reading.panels_of(found.session.display):
        return []
    drawn = _draw_rejections(folder / "decoding.png", found)
    return [Picture("Decoding", drawn, "Camera pixels of every set of the panel.")]


def _coverage(folder: Path, each: EyeCalibration, several: bool) -> Picture:
    name = f"coverage-{each.eye}" if several else "coverage"
    title = f"Coverage, {each.eye} eye" if several else "Coverage"
    return Picture(title, _draw_coverage(folder / f"{name}.png", each), "Camera positions and their views.")


def _read_table(session: PhotoSession, reading: Reading) -> ReportTable:
    rows: list[list[Cell]] = []
    for name, photographs in (
        ("target without the headset", session.bare),
        ("target by the tracking camera", session.tracking),
        ("target through the optics", session.see_through),
        *((("target past the optics", session.beside),) if session.beside else ()),
    ):
        dots = [len(observation) for _, observation in reading.views_of(photographs)]
        sigma = [float(np.median(observation.sigma_px)) for _, observation in reading.views_of(photographs)]
        rows.append([name, len(photographs), len(dots), sum(dots), float(np.median(sigma)) if sigma else None])
    samples = [each.samples for _, each in reading.panels_of(session.display)]
    sigma_px = float(np.median(np.concatenate([each.sigma_px for each in samples]))) if samples else None
    rows.append(["panel", len(session.display), len(samples), sum(len(each) for each in samples), sigma_px])
    columns = ["photographs of", "given", "read", "features or samples", "sigma per reading (px)"]
    notes = (
        "Sigma: in camera pixels for features, in panel pixels for samples of the panel. A sample is the mean of a "
        "window of camera pixels.",
        "Features outside the panel's field of view, and outliers, are not fitted.",
    )
    return ReportTable("Readings", columns, rows, notes)


def _excluded_table(excluded: Iterable[Excluded]) -> ReportTable:
    return table("Excluded", excluded, {"photograph": "name", "reason": "reason"})


def _decoded_table(session: PhotoSession, reading: Reading) -> ReportTable:
    rows: list[list[Cell]] = []
    for each, panel in reading.panels_of(session.display):
        share = panel.counts / panel.counts.sum()
        low, high = panel.extent
        covered = float(np.prod((high - low) / session.panels[each.eye].pattern.panel.size_px))
        rejected: Counter[str] = Counter(
            {
                reason.name.lower().replace("_", " "): float(share[reason])
                for reason in Rejection
                if reason > Rejection.DARK
            }
        )
        most = [f"{name} {100 * part:.2g} %" for name, part in rejected.most_common(2) if part > _NAMED]
        name = session.name_of(each.folder)
        rows.append([name, 100 * float(share[0]), 100 * covered, len(panel.samples), ", ".join(most) or "-"])
    columns = ["set", "decoded (% of picture)", "panel's box seen (%)", "samples", "main rejections, except dark"]
    return ReportTable("Decoded sets", columns, rows)


def _lens_table(found: SessionCalibration) -> ReportTable:
    adjustment = found.bench.adjustment
    rows: list[list[Cell]] = []
    for name, lens in adjustment.state.lens.items():
        rows.append([f"{name} camera", "kind", getattr(lens, "kind", "splined")])
        sigma = np.sqrt(np.diag(adjustment.covariance_of([("lens", name)])))
        held = adjustment.state.blocks["lens", name].size <= EXACT
        rows += [
            [
                f"{name} camera",
                value,
                Number(number, ".6g") if is_held else Estimate(float(number), float(one), digits=2),
            ]
            for value, number, one, is_held in zip(lens.names, lens.values, sigma, held, strict=True)
            if value != RESIDUAL
        ]
        if isinstance(lens, ResidualLens):
            rows.append([f"{name} camera", "residual, rms (px)", lens.rms_px])
    notes = (
        "Focal length and centre in pixels, the centre from the outer corner of the top-left pixel. A term without a "
        "sigma is stated, or the residual field replaces it.",
    )
    return ReportTable("Lenses", ["camera", "value", "found +- one sigma"], rows, notes)


def _kinds_tables(found: SessionCalibration) -> list[ReportTable]:
    rows: list[list[Cell]] = [
        [f"{name} camera", kind, rms, "chosen" if kind == getattr(each.lens, "kind", "") else ""]
        for name, each in found.bench.lenses.items()
        for kind, rms in each.tried.items()
    ]
    note = "The simplest kind that predicts held-out photographs as well as any is chosen."
    columns = ["camera", "kind of lens", "held-out reprojection error, rms (px)", ""]
    return [ReportTable("Kinds of lenses", columns, rows, (note,))] if rows else []


def _poses(found: SessionCalibration) -> dict[str, Pose]:
    bench, poses = found.bench, {}
    for eye, each in found.eyes.items():
        first = each.session.display[0] if each.session.display else each.session.see_through[0]
        which = f", {eye} eye" if len(found.eyes) > 1 else ""
        poses[f"eyeball camera at the first panel photographs{which}"] = bench.camera_pose(first)
    return poses | {f"target pose {number}": pose for number, pose in bench.targets.items()}


def _poses_table(found: SessionCalibration) -> ReportTable:
    rows: list[list[Cell]] = []
    for name, pose in _poses(found).items():
        place = ", ".join(f"{1e3 * length:.3f}" for length in pose.b_from_a[:3, 3])
        turn, shift = (
            " / ".join(f"{one:#.2g}".rstrip(".") for one in sigma) for sigma in (pose.sigma_arcmin, pose.sigma_mm)
        )
        rows.append([name, place, shift, turn])
    columns = ["pose", "origin (mm)", "its sigma x / y / z (mm)", "sigma of rotation about x / y / z (arcmin)"]
    notes = ("Device frame with OpenXR's axes (x right, y up, z backward), whatever axes session.toml has.",)
    return ReportTable("Poses in the device frame", columns, rows, notes)


def _errors_table(found: SessionCalibration) -> ReportTable:
    """Tabulate the errors of stage and board that the photographs show."""
    adjustment = found.bench.adjustment
    sizes, state = adjustment.sizes, adjustment.state
    rows: list[list[Cell]] = []
    if state.of("offset"):
        rows += [
            ["stage, repeatability of position (um)", 1e6 * sizes["shift"]],
            ["stage, repeatability of rotation (urad)", 1e6 * sizes["turn"]],
            ["stage, error along an axis by its reading (um)", 1e6 * sizes["screw"]],
            ["stage, smooth error of position over the travel (um)", 1e6 * sizes["smooth shift"]],
            ["stage, smooth error of rotation over the travel (urad)", 1e6 * sizes["smooth turn"]],
        ]
    for name, shape in state.shape.items():
        sigma = np.sqrt(np.diag(adjustment.covariance_of([("shape", name)])))
        for k, value in enumerate(BOARD_SHAPE):
            unit = "um" if k < 3 else "parts per million"
            rows.append([f"{name}, {value} ({unit})", Estimate(1e6 * float(shape.low[k]), 1e6 * float(sigma[k]))])
        rows.append([f"{name}, errors of single features (um)", 1e6 * sizes.feature_m[name]])
    if state.of("drift"):
        rows.append(["camera, drift of the image in the session (arcmin)", sizes["drift"] / ARCMIN])
    rows.append(["boards, smooth printing errors (um)", 1e6 * sizes["print"]])
    rows.append(["boards, heights in addition to bow and twist (um)", 1e6 * sizes["height"]])
    for target, (change,) in state.of("focus").items():
        sigma_change = float(np.sqrt(adjustment.covariance_of([("focus", target)])[0, 0]))
        name = f"focal length at target pose {target} (parts per million)"
        rows.append([name, Estimate(1e6 * change, 1e6 * sigma_change)])
    note = "Standard deviations per axis, estimated from the photographs; the sigmas of all poses include them."
    return ReportTable("Errors of stage, board and lens", ["error", "found +- one sigma"], rows, (note,))


def _chi_squared_table(found: SessionCalibration) -> ReportTable:
    pulls = [*reading_pulls(found.bench.adjustment), *prior_pulls(found.bench.adjustment)]
    columns = {
        "residuals": "kind",
        "reduced chi-squared": "reduced",
        "degrees of freedom": "freedom",
        "probability by chance": "probability",
    }
    notes = (
        "Features: against their stated sigma, which is known to a factor of two.",
        "Stage: against the repeatability found.",
        "Stated values (poses, known lenses, the board's file): against their stated sigma.",
    )
    return table("Reduced chi-squared", pulls, columns, notes)


def _checks_table(found: SessionCalibration) -> ReportTable:
    columns: Columns = {
        "check": lambda check: "passed" if check.ok else "FAILED",
        "step": "step",
        "quantity": "quantity",
        "value +- one sigma": lambda check: Estimate(float(check.value), float(check.sigma)),
        "limit": lambda check: float(check.limit),
        "what it says": "sentence",
    }
    notes = ("A value beyond its limit by no more than a few sigma passes.", *found.bench.unchecked)
    return table("Checks of the bench", sorted(found.bench.checks, key=lambda check: check.ok), columns, notes)


def _draw_coverage(path: Path, found: EyeCalibration) -> Path:
    """Draw camera positions with the eye box, decoded panel positions, and the directions of the target features."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.5, 4.2), layout="constrained")
    places, panel, world = figure.subplots(1, 3)
    box, display, see_through = found.session.eye_box, found.captures.display, found.captures.see_through
    if display is not None:
        x, y = 1e3 * np.unique(display.viewpoint, axis=0)[:, :2].T
        places.plot(x, y, "o", label="panel")
    if see_through is not None:
        x, y = 1e3 * np.unique(see_through.viewpoint, axis=0)[:, :2].T
        places.plot(x, y, "+", markersize=10, label="through the optics")
    (left, bottom), (width, height) = 1e3 * (box.centre - box.size / 2)[:2], 1e3 * box.size[:2]
    places.plot(
        left + width * np.array([0, 1, 1, 0, 0]), bottom + height * np.array([0, 0, 1, 1, 0]), "k-", label="eye box"
    )
    places.set(xlabel="x (mm)", ylabel="y (mm)", title="camera positions", aspect="equal")
    places.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=3)
    if display is not None:
        size = found.session.pattern.panel.size_px
        u, v = display.pixel.T
        counts, _, _ = np.histogram2d(u, v, bins=(48, 27), range=[(0.0, float(size[0])), (0.0, float(size[1]))])
        drawn = panel.imshow(counts.T, extent=(0, size[0], size[1], 0), cmap="viridis")
        figure.colorbar(drawn, ax=panel, shrink=0.7, label="samples")
    panel.set(xlabel="u (px)", ylabel="v (px)", title="decoded panel positions")
    for pose in np.unique(see_through.target_pose) if see_through is not None else ():
        assert see_through is not None
        tangents = see_through.tangents[see_through.target_pose == pose]
        world.plot(*np.rad2deg(np.arctan(tangents)).T, ".", markersize=1, label=f"target pose {pose}")
    if display is not None:
        seen = np.rad2deg(np.arctan(display.tangents))
        low, high = seen.min(axis=0), seen.max(axis=0)
        world.plot(
            [low[0], high[0], high[0], low[0], low[0]], [low[1], low[1], high[1], high[1], low[1]], "k-", label="panel"
        )
    world.set(xlabel="to the right (degrees)", ylabel="up (degrees)", title="where features were seen", aspect="equal")
    world.legend(fontsize=7, markerscale=8, loc="upper center", bbox_to_anchor=(0.5, -0.32), ncols=3)
    return write_figure(path, figure, 110)


def _draw_rejections(path: Path, found: SessionCalibration) -> Path:
    """Draw the result of decoding for each camera pixel of every set of code photographs."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    colours = rejection_colours()
    colour_map = ListedColormap(colours)
    sets = found.reading.panels_of(found.session.display)
    rows = -(-len(sets) // _ACROSS)
    figure = Figure(figsize=(13.5, 1.9 * rows + 0.8), layout="constrained")
    axes = figure.subplots(rows, _ACROSS, squeeze=False).ravel()
    for unused in axes[len(sets) :]:
        unused.set_axis_off()
    for drawn, (each, panel) in zip(axes, sets, strict=False):
        drawn.set(xticks=[], yticks=[])
        drawn.imshow(panel.fates, cmap=colour_map, vmin=-0.5, vmax=len(colours) - 0.5, interpolation="nearest")
        drawn.set_title(found.session.name_of(each.folder), fontsize=7)
    present = sorted({int(fate) for _, panel in sets for fate in np.unique(panel.fates)})
    names = [Rejection(fate).name.lower().replace("_", " ") for fate in present]
    patches = [Patch(color=colours[fate], label=name) for fate, name in zip(present, names, strict=True)]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(patches), fontsize=8)
    return write_figure(path, figure, 110)
