"""The on-device experiment from its photographs: options in, tables and pictures out."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.calibration.station_file import load_station
from wlr_render.errors import BadInputError
from wlr_render.files import output_folder, write_text
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.jobs.simulate.making import load_making
from wlr_render.jobs.verify import pictures, procedure
from wlr_render.jobs.verify.judgement import Judged
from wlr_render.jobs.verify.pairs import judge_pairs
from wlr_render.jobs.verify.shown_dots import wholly_shown
from wlr_render.jobs.verify.tables import misalignment_tables
from wlr_render.models.model_file import load_eye_model
from wlr_render.progress import SILENT, Progress
from wlr_render.report.blocks import ReportTable, tables_as_json
from wlr_render.simulation.photographs.photo_bench import PhotoBench
from wlr_render.simulation.viewpoints import random_in_eye_box


@dataclass(frozen=True)
class Options:
    """What to verify.

    Attributes:
        session: a simulated session; its bench is used again, with everything true about it.
        calibration: folder of what `calibrate` made of that session: model.json and station.json.
        out: for photographs, tables and pictures.
        viewpoints: places of the camera in the eye box; the first is its middle.
        depths_m: where the target stands, one after the other.
        seed: of the places and of the noise.
        backend: who rasterises.
    """

    session: Path
    calibration: Path = Path("out/calibrate")
    out: Path = Path("out/verify")
    viewpoints: int = 5
    depths_m: tuple[float, ...] = (0.5, 0.8)
    seed: int = 1
    backend: str = "auto"


@dataclass(frozen=True)
class Result:
    """Tables in the order of telling, and the files written."""

    tables: tuple[ReportTable, ...]
    files: tuple[Path, ...]


def run(options: Options, workers: int | None = None, progress: Progress = SILENT) -> Result:
    """Draw, photograph, match; writes verification.md, verification.json and pictures.

    Raises:
        BadInputError: the session is not a simulated one, the calibration is missing or of another session, or the
            target is not seen where it stands.
    """
    bench = load_making(options.session).build()
    if not (options.calibration / "model.json").is_file():
        raise BadInputError(
            f"{options.calibration}: holds no model.json; run `wlr-render calibrate {options.session} --out "
            f"{options.calibration}` first, or name its folder with --calibration."
        )
    model = load_eye_model(options.calibration / "model.json")
    models, station = model.mappings, load_station(options.calibration / "station.json")
    _refuse_another(options, (model.device, models.eye), station.eyeball_camera, bench)
    folder = output_folder(options.out)
    photographs = folder / "photographs"
    box = bench.optics.eye_box
    rng = np.random.default_rng([options.seed, 2])
    others = random_in_eye_box(box, options.viewpoints, rng)[1:] - box.centre
    stage = np.round(np.concatenate([np.zeros((1, 3)), others]), 6)
    viewpoints = np.stack([station.device_from_camera(reading)[:3, 3] for reading in stage])
    targets = procedure.track_targets(bench, station, options.depths_m, photographs)
    total = len(targets) * len(stage)
    drawn = progress(
        (frames for pose in targets for frames in procedure.draw(models, bench, pose, viewpoints, options.backend)),
        total,
        "frames",
    )
    flat = list(drawn)
    frames = [flat[len(stage) * k : len(stage) * (k + 1)] for k in range(len(targets))]
    procedure.photograph(bench, stage, options.depths_m, frames, photographs, options.seed, progress, workers)
    judged = [
        one
        for depth, target in zip(options.depths_m, targets, strict=True)
        for number, viewpoint in enumerate(viewpoints)
        for one in procedure.judge(
            bench,
            station.eyeball_camera,
            depth,
            number,
            wholly_shown(models, bench.board, target, viewpoint),
            photographs,
        )
    ]
    return _write(folder, judged, models.name, session=str(options.session), models=models.name, seed=options.seed)


def run_pairs(pairs: Path, board: Path, calibration: Path, out: Path) -> Result:
    """Judge pairs of photographs that a lab has taken; writes what `run` writes.

    Raises:
        BadInputError: as `judge_pairs`.
    """
    judged = judge_pairs(pairs, board, calibration)
    return _write(output_folder(out), judged, pairs.name, photographs=str(pairs), calibration=str(calibration))


def _write(folder: Path, judged: Sequence[Judged], what: str, **context: object) -> Result:
    tables = misalignment_tables(judged, what)
    files = [
        write_text(folder / "verification.md", "\n".join(table.markdown() for table in tables)),
        write_text(folder / "verification.json", tables_as_json(tables, **context)),
        pictures.draw_misalignment(folder / "misalignment.png", judged),
        pictures.draw_close_up(folder / "close_up.png", judged),
    ]
    return Result(tables, tuple(files))


def _refuse_another(options: Options, calibrated: tuple[str, str], camera: LensCamera, bench: PhotoBench) -> None:
    if calibrated != (bench.device.name, bench.eye) or camera.size_px != bench.eyeball.camera.size_px:
        raise BadInputError(
            f"{options.calibration}: is a calibration of {calibrated[0]}, {calibrated[1]} eye, with a camera of "
            f"{camera.size_px[0]} x {camera.size_px[1]} pixels, and not of {options.session}; name the folder of what "
            "`wlr-render calibrate` made of that session."
        )
