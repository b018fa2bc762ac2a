"""Plan a session: where to put the camera, and how many photographs reach an accuracy."""

from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated

from wlr_render.errors import BadInputError
from wlr_render.io.atomic_files import output_folder, write_text
from wlr_render.jobs import limits
from wlr_render.jobs.headset import is_model
from wlr_render.jobs.job import job
from wlr_render.jobs.options import (
    Against,
    Code,
    EyeName,
    OnlyWith,
    Options,
    ProgressArgument,
    Range,
    Seed,
    described,
    described_size,
    flag_of,
    option_group,
)
from wlr_render.jobs.places_file import places_csv
from wlr_render.jobs.plan.next_places import plan_next_places
from wlr_render.jobs.plan.plan_report import plan_report
from wlr_render.optics.device_file import device_path, load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.planning.planned_bench import PlannedBench, ReadingOptions
from wlr_render.planning.search import LEAST_PLACES, find_design
from wlr_render.report.blocks import Report
from wlr_render.simulation.photographs.imperfections import BenchImperfections
from wlr_render.simulation.photographs.photo_bench import PhotoBenchOptions
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.work.progress import SILENT

_BENCH = option_group("Bench", 1)
_ADD = option_group("Places to add to a calibration", 2)
_USUAL, _READINGS = BenchImperfections(), ReadingOptions()
PLACES_FILE = "places.csv"


@dataclass(frozen=True)
class PlanOptions(Options):
    """Options of `plan`."""

    device: Annotated[str, described("A shipped device or a device file (.toml).")]
    _: KW_ONLY
    eye: Annotated[EyeName, described("Eye to calibrate.")] = "right"
    accuracy_arcmin: Annotated[
        float, described("Wanted registration error in arcmin, of 95 % of the eye box."), Range(0.001, 600)
    ] = 0.3
    repeatability_um: Annotated[
        float,
        described("Repeatability of the stage in um, standard deviation per axis.", group=_BENCH),
        limits.REPEATABILITY_UM,
    ] = _USUAL.repeatability_um
    turn_jitter_urad: Annotated[
        float,
        described("Random rotation of each visit in urad, standard deviation per axis.", group=_BENCH),
        limits.ROTATION_URAD,
    ] = _USUAL.turn_jitter_urad
    in_depth: Annotated[
        bool,
        described(
            "Choose camera places before and behind the middle plane of the eye box, too: for a stage of three axes, "
            "calibrated at five levels of each.",
            flag=True,
            group=_BENCH,
        ),
    ] = False
    dot_noise_px: Annotated[
        float, described("Noise of a dot of the board, per axis, in camera pixels.", group=_BENCH), limits.NOISE_PX
    ] = _READINGS.dot_px
    panel_noise_px: Annotated[
        float, described("Noise of a decoded panel position, per axis, in panel pixels.", group=_BENCH), limits.NOISE_PX
    ] = _READINGS.panel_px
    camera: Annotated[
        tuple[int, int], described_size("Pixels of the eyeball camera.", group=_BENCH), limits.CAMERA_PIXELS
    ] = PhotoBenchOptions.camera_px
    depths_m: Annotated[
        tuple[float, ...],
        described("Distances of the target in m, two or more.", many=True, group=_BENCH),
        limits.DISTANCE_M,
    ] = PhotoBenchOptions.target_depths_m
    pattern: Annotated[Code, described("Code that the panel shows.", group=_BENCH)] = "gray-fringes"
    seconds: Annotated[float, described("Seconds a photograph takes.", group=_BENCH), Range(above=0, at_most=3600)] = (
        2.0
    )
    most_places: Annotated[
        int, described("Maximum number of camera positions."), Range(at_least=LEAST_PLACES, at_most=200)
    ] = 81
    calibration: Annotated[
        Path | None,
        described(
            "Folder of a calibration of this headset (captures-EYE.npz): plan the places to add to it.", group=_ADD
        ),
    ] = None
    add: Annotated[
        int,
        described("Maximum number of places to add to --calibration.", group=_ADD),
        Range(at_least=1, at_most=20),
        OnlyWith("calibration"),
    ] = 4
    seed: Seed = 1
    out: Annotated[Path, described("Output folder.")] = Path("out/plan")
    against: Against = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_product(limits.DEPTHS, "distances", "depths_m")
        if len(set(self.depths_m)) < 2:
            raise BadInputError(
                f"{flag_of(type(self), 'depths_m')} is {' '.join(f'{each:g}' for each in self.depths_m)}; see-through "
                "needs targets at two distances at least, e.g. 0.4 1."
            )

    @property
    def recipe(self) -> SimulationRecipe:
        """Recipe of the simulation: the headset and the bench."""
        sizes = replace(
            _USUAL,
            repeatability_um=self.repeatability_um,
            turn_jitter_urad=self.turn_jitter_urad,
        )
        bench = PhotoBenchOptions(
            self.camera, target_depths_m=tuple(sorted(self.depths_m)), seed=self.seed, imperfections=sizes
        )
        return SimulationRecipe(self.device, self.eye, self.most_places, self.pattern, bench)


@job
def plan(options: PlanOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Plan a session, or the places to add to one; writes places.csv and the report into `options.out`.

    Raises:
        BadInputError: an unknown device or eye, an impossible bench, or a calibration that cannot be read.
    """
    if is_model(options.device):
        raise BadInputError(
            f"{options.device}: is a fitted model; a plan needs the headset's prescription: name a shipped device or "
            "a device file."
        )
    device = load_device(options.device)
    truth = replace(traced_eye(device, options.eye), name=device.name)
    inputs = [device_path(options.device)]
    noise = ReadingOptions(options.dot_noise_px, options.panel_noise_px)
    bench = PlannedBench(truth, options.recipe, noise, options.recipe.build(), options.in_depth)
    if options.calibration is not None:
        report, places = plan_next_places(
            bench, options.calibration, options.accuracy_arcmin, options.add, progress.say
        )
    else:
        search = find_design(bench, options.accuracy_arcmin, options.most_places, progress.say)
        report = plan_report(search, options.accuracy_arcmin, options.seconds)
        places = bench.places(search.recommended.design.unit) - truth.eye_box.centre
    folder = output_folder(options.out)
    written = write_text(folder / PLACES_FILE, places_csv(places))
    record = {"places_mm": 1e3 * places} | dict(report.record)
    return replace(report, inputs=[*inputs, *report.inputs], files=[written], record=record)
