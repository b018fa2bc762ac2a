"""Options of `simulated-lab`."""

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

from wlr_render.errors import BadInputError
from wlr_render.jobs import limits
from wlr_render.jobs.options import Backend, OnlyWith, Range, Scheduler, Seed, SpreadOptions, Workers, described
from wlr_render.planning.planned_bench import ReadingOptions
from wlr_render.simulation.photographs.photo_bench import Family

PartName = Literal["codes", "truth", "registration", "bench", "faults", "models"]
TargetPose = Literal["frontal", "tilted", "shifted"]


@dataclass(frozen=True)
class SimulatedLabOptions(SpreadOptions):
    """Options of `simulated-lab`."""

    _: KW_ONLY
    part: Annotated[
        tuple[PartName, ...],
        described(
            "Measurements to make, one or more: codes; truth, the calibration of --session against its truth; "
            "registration, photographs of the drawn target; bench, faults and models.",
            many=True,
        ),
    ] = ("codes",)
    benches: Annotated[
        int, described("Sessions of simulated benches."), Range(at_least=1), OnlyWith("part", ("bench",))
    ] = 40
    faults: Annotated[int, described("Sessions with each fault."), Range(at_least=1), OnlyWith("part", ("faults",))] = (
        20
    )
    models: Annotated[
        int, described("Sessions whose models are fitted."), Range(at_least=1), OnlyWith("part", ("models",))
    ] = 6
    family: Annotated[
        Family,
        described("Errors of stage, board, lenses and warm-up, as of `simulate`."),
        OnlyWith("part", ("bench", "faults", "models")),
    ] = "polynomial"
    dots: Annotated[
        int,
        described("Largest number of dots of a photograph; positions on the panel are fewer in the same ratio."),
        Range(at_least=50),
        OnlyWith("part", ("bench", "faults", "models")),
    ] = ReadingOptions.most_dots
    resume: Annotated[
        bool,
        described("Keep the trials of benches that an earlier run of the same program left there.", flag=True),
    ] = False
    workers: Workers = None
    scheduler: Scheduler = None
    record: Annotated[Path | None, described("Folder in which simulated-lab-PARTS.md is kept, too.")] = None
    session: Annotated[
        Path | None,
        described("Folder of a simulated session."),
        OnlyWith("part", ("truth", "registration")),
    ] = None
    calibration: Annotated[
        tuple[Path, ...],
        described(
            "Output folders of `calibrate`; truth takes the first, registration compares all, which may be of "
            "other sessions of the same bench.",
            many=True,
        ),
    ] = (Path("out/calibrate"),)
    viewpoints: Annotated[
        int,
        described("Number of camera positions in the eye box."),
        limits.PLACES,
        OnlyWith("part", ("registration",)),
    ] = 5
    depths_m: Annotated[
        tuple[float, ...],
        described("Distances of the target in m.", many=True),
        limits.DISTANCE_M,
        OnlyWith("part", ("registration",)),
    ] = (0.5, 0.8)
    poses: Annotated[
        tuple[TargetPose, ...],
        described(
            "Poses of the target at each distance: facing the eye, tilted, shifted (default: frontal for one "
            "calibration, all for several).",
            flag=True,
            many=True,
        ),
        OnlyWith("part", ("registration",)),
    ] = ()
    backend: Annotated[Backend, OnlyWith("part", ("registration",))] = "auto"
    snr: Annotated[float, described("Signal-to-noise ratio of a white panel."), Range(above=0)] = 20.0
    seed: Seed = 1
    out: Annotated[Path, described("Output folder.")] = Path("out/benchmarks/simulated-lab")

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_product(10_000, "photographs", "viewpoints", "depths_m")
        if self.session is None and {"truth", "registration"} & {*self.part}:
            raise BadInputError("--part truth and registration need --session, the folder of a simulated session.")

    @property
    def simulated_session(self) -> Path:
        """The session, for the parts that need one."""
        assert self.session is not None  # a missing session was refused before
        return self.session
