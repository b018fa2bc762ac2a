"""The report of a calibration from photographs: what was read, how certain the station is, how well the models fit."""

from collections import Counter
from pathlib import Path

import numpy as np

from wlr_render.calibration.calibrate_session import Lens, SessionCalibration
from wlr_render.calibration.poses import Pose
from wlr_render.captures.decoded import Rejection
from wlr_render.files import write_figure
from wlr_render.geometry.lens_camera import LENS_PARAMETERS
from wlr_render.jobs.calibrate.fit_findings import fit_advice, fit_blocks, fit_sentences
from wlr_render.jobs.decode import rejection_colours
from wlr_render.report.blocks import Block, Cell, Picture, Plot, ReportTable, Section
from wlr_render.report.plots import bars

_ACROSS = 6  # small pictures side by side


def headline(found: SessionCalibration) -> str:
    """What was read, what came of it, and whether anything is off."""
    off = sum(not check.ok for check in found.station.checks)
    checks = f"{off} check(s) of the station failed" if off else "every check of the station passed"
    return (
        f"{fit_sentences(found.kinds)} {len(found.reading.boards)} photographs of the board and "
        f"{len(found.reading.panels)} sets of the panel were read, {len(found.all_excluded)} excluded; {checks}."
    )


def advice(found: SessionCalibration) -> list[str]:
    """What to do next: about faults and failed checks, then about camera positions to add."""
    steps = ["Correct the entries of session.toml that are excluded, or take the photographs again."] * bool(
        found.faults
    )
    steps += [f"{check.step}: {check.sentence}" for check in found.station.checks if not check.ok]
    return [*steps, *fit_advice(found.fit)]


def set_names(found: SessionCalibration) -> list[str]:
    """Names of the panel's photographed sets, by number of the display's capture."""
    return [found.session.name_of(each.folder) for each, _ in found.reading.decoded(found.session.display)]


def session_blocks(found: SessionCalibration, folder: Path) -> list[Block]:
    """Tables, pictures (written into `folder`) and plots, in the order of the procedure."""
    read = [_read_table(found), _excluded_table(found), _decoded_table(found)]
    return [
        Section("What was read"),
        *(table for table in read if table.rows),
        Picture("Coverage", _draw_coverage(folder / "coverage.png", found), "Camera positions, and what they saw."),
        Picture(
            "Decoding", _draw_rejections(folder / "decoding.png", found), "Camera pixels of every set of the panel."
        ),
        Section("The station"),
        _lens_table(found),
        _poses_table(found),
        *_pose_plots(found),
        _checks_table(found),
        Section("The models"),
        *fit_blocks(found.kinds, found.captures, set_names(found)),
    ]


def _read_table(found: SessionCalibration) -> ReportTable:
    session, reading = found.session, found.reading
    rows: list[list[Cell]] = []
    for name, photographs in (
        ("target without the headset", session.bare),
        ("target by the tracking camera", session.tracking),
        ("target through the optics", session.see_through),
    ):
        dots = [len(observation) for _, observation in reading.seen(photographs)]
        sigma = [float(np.median(observation.sigma_px)) for _, observation in reading.seen(photographs)]
        rows.append([name, len(photographs), len(dots), sum(dots), float(np.median(sigma)) if sigma else None])
    samples = [each.samples for _, each in reading.decoded(session.display)]
    sigma_px = float(np.median(np.concatenate([each.sigma_px for each in samples]))) if samples else None
    rows.append(["panel", len(session.display), len(samples), sum(len(each) for each in samples), sigma_px])
    columns = ["photographs of", "given", "read", "dots or samples", "sigma per reading (px)"]
    notes = (
        "Dots: camera pixels. Samples of the panel: panel pixels, each the mean of a window of camera pixels.",
        "Dots beyond the panel's field, and dots that lie off their position (outliers), are not fitted.",
    )
    return ReportTable("What was read", columns, rows, notes)


def _excluded_table(found: SessionCalibration) -> ReportTable:
    rows: list[list[Cell]] = [[name, reason] for name, reason in found.all_excluded]
    return ReportTable("Excluded", ["photograph", "reason"], rows)


def _decoded_table(found: SessionCalibration) -> ReportTable:
    rows: list[list[Cell]] = []
    for each, panel in found.reading.decoded(found.session.display):
        share = panel.counts / panel.counts.sum()
        low, high = panel.extent
        covered = float(np.prod((high - low) / found.session.pattern.panel.size_px))
        rejected: Counter[str] = Counter(
            {
                reason.name.lower().replace("_", " "): float(share[reason])
                for reason in Rejection
                if reason > Rejection.DARK
            }
        )
        most = [f"{name} {100 * part:.2g} %" for name, part in rejected.most_common(2) if part > 0]
        name = found.session.name_of(each.folder)
        rows.append([name, 100 * float(share[0]), 100 * covered, len(panel.samples), ", ".join(most) or "-"])
    columns = ["set", "decoded (% of picture)", "panel's box seen (%)", "samples", "most rejected, but for dark"]
    return ReportTable("Decoded sets", columns, rows)


def _lens_table(found: SessionCalibration) -> ReportTable:
    rows: list[list[Cell]] = []
    for name, lens in (("eyeball camera", found.eyeball), ("tracking camera", found.tracking)):
        rows += _lens_rows(name, lens)
    notes = ("Focal length and centre in pixels, the centre from the outer corner of the top-left pixel.",)
    return ReportTable("Lenses", ["camera", "value", "found", "standard deviation"], rows, notes)


def _lens_rows(name: str, lens: Lens) -> list[list[Cell]]:
    camera, found = lens.camera, lens.calibration
    values = np.concatenate([camera.focal_px, camera.centre_px, camera.distortion])
    sigma = [None] * len(values) if found is None else [float(one) for one in found.sigma]
    rows: list[list[Cell]] = [
        [name, value, f"{number:.6g}", one]
        for value, number, one in zip(LENS_PARAMETERS, values, sigma, strict=True)
        if number != 0
    ]
    misfit = float(np.sqrt(np.mean(lens.poses.rms_px**2)))
    return [*rows, [name, "reprojection error, rms (px)", f"{misfit:.3g}", None]]


def _poses(found: SessionCalibration) -> dict[str, Pose]:
    station = found.station
    poses = {"eyeball camera, at the reference reading": station.pose_at(station.stage.reference)}
    return poses | {f"target pose {number}": pose for number, pose in station.device_from_target.items()}


def _pose_plots(found: SessionCalibration) -> list[Plot]:
    poses = _poses(found)
    plots = []
    for title, unit, sigmas in (
        ("Uncertainty of positions", "mm", [pose.sigma_mm for pose in poses.values()]),
        ("Uncertainty of rotations", "arcmin", [pose.sigma_arcmin for pose in poses.values()]),
    ):
        axes = dict(zip("xyz", np.transpose(sigmas), strict=True))
        plots.append(
            bars(title, list(poses), axes, f"sigma ({unit})", caption="Of poses in the device frame, per axis.")
        )
    return plots


def _poses_table(found: SessionCalibration) -> ReportTable:
    station = found.station
    rows: list[list[Cell]] = []
    for name, pose in _poses(found).items():
        place = ", ".join(f"{1e3 * length:.3f}" for length in pose.b_from_a[:3, 3])
        turn, shift = (" / ".join(f"{one:.2g}" for one in sigma) for sigma in (pose.sigma_arcmin, pose.sigma_mm))
        rows.append([name, place, shift, turn])
    columns = ["pose", "origin (mm)", "its sigma x / y / z (mm)", "sigma of rotation about x / y / z (arcmin)"]
    jitter = station.stage.jitter
    notes = (
        "Device frame with OpenXR's axes (x right, y up, z backward), whatever axes session.toml has.",
        f"Repeatability of the stage: {1e6 * jitter.translation_m:.2g} um and {1e6 * jitter.rotation_rad:.2g} "
        "microradians per axis; the eyeball camera's sigmas include it.",
    )
    return ReportTable("Poses in the device frame", columns, rows, notes)


def _checks_table(found: SessionCalibration) -> ReportTable:
    rows: list[list[Cell]] = [
        [
            "passed" if check.ok else "FAILED",
            check.step,
            check.quantity,
            float(check.value),
            float(check.limit),
            check.sentence,
        ]
        for check in sorted(found.station.checks, key=lambda check: check.ok)
    ]
    columns = ["check", "step", "quantity", "value", "limit", "what it says"]
    return ReportTable("Checks of the station", columns, rows, tuple(found.station.unchecked))


def _draw_coverage(path: Path, found: SessionCalibration) -> Path:
    """Camera positions with the eye box, the panel as it was decoded, and the directions in which targets were seen."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.5, 4.2), layout="constrained")
    places, panel, world = figure.subplots(1, 3)
    box, display, see_through = found.session.eye_box, found.captures.display, found.captures.see_through
    assert see_through is not None
    x, y = 1e3 * np.unique(display.viewpoint, axis=0)[:, :2].T
    places.plot(x, y, "o", label="panel")
    x, y = 1e3 * np.unique(see_through.viewpoint, axis=0)[:, :2].T
    places.plot(x, y, "+", markersize=10, label="through the optics")
    (left, bottom), (width, height) = 1e3 * (box.centre - box.size / 2)[:2], 1e3 * box.size[:2]
    places.plot(
        left + width * np.array([0, 1, 1, 0, 0]), bottom + height * np.array([0, 0, 1, 1, 0]), "k-", label="eye box"
    )
    places.set(xlabel="x (mm)", ylabel="y (mm)", title="camera positions", aspect="equal")
    places.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=3)
    size = found.session.pattern.panel.size_px
    u, v = display.pixel.T
    counts, _, _ = np.histogram2d(u, v, bins=(48, 27), range=[(0.0, float(size[0])), (0.0, float(size[1]))])
    drawn = panel.imshow(counts.T, extent=(0, size[0], size[1], 0), cmap="viridis")
    figure.colorbar(drawn, ax=panel, shrink=0.7, label="samples")
    panel.set(xlabel="u (px)", ylabel="v (px)", title="decoded panel positions")
    for pose in np.unique(see_through.target_pose):
        tangents = see_through.tangents[see_through.target_pose == pose]
        world.plot(*np.rad2deg(np.arctan(tangents)).T, ".", markersize=1, label=f"target pose {pose}")
    seen = np.rad2deg(np.arctan(display.tangents))
    low, high = seen.min(axis=0), seen.max(axis=0)
    world.plot(
        [low[0], high[0], high[0], low[0], low[0]], [low[1], low[1], high[1], high[1], low[1]], "k-", label="panel"
    )
    world.set(xlabel="to the right (degrees)", ylabel="up (degrees)", title="where dots were seen", aspect="equal")
    world.legend(fontsize=7, markerscale=8, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=3)
    return write_figure(path, figure, 110)


def _draw_rejections(path: Path, found: SessionCalibration) -> Path:
    """Of every set of code photographs, what became of each camera pixel."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    colours = rejection_colours()
    colour_map = ListedColormap(colours)
    sets = found.reading.decoded(found.session.display)
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
