"""Simulate a session of photographs, as a lab would deliver it."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import LIMITS
from wlr_render.jobs import limits
from wlr_render.jobs.job import job
from wlr_render.jobs.options import (
    Code,
    EyeName,
    OnlyWith,
    ProgressArgument,
    Range,
    Scheduler,
    Seed,
    SpreadOptions,
    Workers,
    described,
    described_size,
    flag_of,
    option_group,
)
from wlr_render.jobs.places_file import read_places
from wlr_render.optics.device_file import load_device
from wlr_render.optics.traced_mappings import traced_eye
from wlr_render.report.blocks import Report
from wlr_render.simulation.photographs.imperfections import BenchImperfections, LensKind
from wlr_render.simulation.photographs.photo_bench import Family, PhotoBenchOptions, Sampling, half_travel
from wlr_render.simulation.photographs.photo_plan import unreadable_targets
from wlr_render.simulation.photographs.recipe import SimulationRecipe
from wlr_render.simulation.photographs.simulate_photo_session import simulate_photo_session
from wlr_render.work.progress import SILENT

_PLACES = option_group("Photographs", 1)
_CAMERAS = option_group("Cameras", 2)
_ERRORS = option_group("Errors of the bench", 3)
_USUAL = PhotoBenchOptions()
_POLYNOMIAL = OnlyWith("family", ("polynomial",))


@dataclass(frozen=True)
class SimulateOptions(SpreadOptions):
    """Options of `simulate`."""

    device: Annotated[str, described("A shipped device or a device file (.toml).")]
    _: KW_ONLY
    out: Annotated[Path, described("Folder of the session; an interrupted simulation continues there.")] = Path(
        "out/session"
    )
    eye: Annotated[EyeName, described("Eye to photograph; a simulated session is of one eye.")] = "right"
    viewpoints: Annotated[int, described("Number of camera positions.", group=_PLACES), limits.PLACES] = 25
    places: Annotated[
        Path | None,
        described(
            "File of camera positions that plan writes (places.csv): visit them in its order, in place of "
            "--viewpoints.",
            group=_PLACES,
        ),
    ] = None
    pattern: Annotated[Code, described("Code that the panel shows.", group=_PLACES)] = "gray-fringes"
    camera: Annotated[
        tuple[int, int], described_size("Pixels of the eyeball camera.", group=_CAMERAS), limits.CAMERA_PIXELS
    ] = _USUAL.camera_px
    tracking_camera: Annotated[
        tuple[int, int], described_size("Pixels of the tracking camera.", group=_CAMERAS), limits.CAMERA_PIXELS
    ] = _USUAL.tracking_px
    bits: Annotated[Literal[8, 10, 12], described("Bits of the eyeball camera.", group=_CAMERAS)] = 8
    pupil_mm: Annotated[float, described("Diameter of its entrance pupil in mm.", group=_CAMERAS), Range(0.01, 50)] = (
        _USUAL.pupil_mm
    )
    focus_m: Annotated[
        float, described("Distance at which it is focused, in m.", group=_CAMERAS), Range(0.01, 1000)
    ] = _USUAL.focus_m
    snr: Annotated[float, described("Signal-to-noise ratio of a white panel.", group=_CAMERAS), Range(1, 100_000)] = (
        _USUAL.snr
    )
    depths_m: Annotated[
        tuple[float, ...],
        described("Distances of the target in m, two or more.", many=True, group=_PLACES),
        limits.DISTANCE_M,
    ] = _USUAL.target_depths_m
    stage: Annotated[Literal["xyz", "xy", "x"], described("Axes of the stage that move.", group=_PLACES)] = "xyz"
    sampling: Annotated[
        Sampling,
        described(
            "Camera positions: in one plane, or three-dimensional in the eye box, as volumetric models need.",
            group=_PLACES,
        ),
    ] = "planar"
    stated_axes_deg: Annotated[
        float,
        described(
            "State the stage's axes in session.toml, rotated by a random error of this standard deviation in degrees "
            "per axis, and photograph the bare target once (default: not stated).",
            flag=True,
            group=_PLACES,
        ),
        Range(at_least=0, at_most=5),
    ] = 0.0
    family: Annotated[
        Family,
        described(
            "Errors of stage, board and lenses: smooth polynomials, or a workshop's screws, backlash, random fields "
            "and warm-up, whose function classes no model of calibration has.",
            group=_ERRORS,
        ),
    ] = "polynomial"
    perfect: Annotated[
        bool,
        described("A bench without imperfections, except the ones set by the options below.", flag=True, group=_ERRORS),
        _POLYNOMIAL,
    ] = False
    repeatability_um: Annotated[
        float | None,
        described("Repeatability of the stage in um, standard deviation per axis.", group=_ERRORS),
        limits.REPEATABILITY_UM,
        _POLYNOMIAL,
    ] = None
    turn_urad: Annotated[
        float | None,
        described("Pitch, yaw and roll of the stage in urad, rms along each axis.", group=_ERRORS),
        limits.ROTATION_URAD,
        _POLYNOMIAL,
    ] = None
    bow_mm: Annotated[
        float | None, described("Bow of the board in mm, middle to corners.", group=_ERRORS), Range(0, 100), _POLYNOMIAL
    ] = None
    anisotropy: Annotated[
        float | None,
        described("Part by which the board is printed longer in y than in x.", group=_ERRORS),
        Range(0, 0.5),
        _POLYNOMIAL,
    ] = None
    lens: Annotated[LensKind | None, described("Distortion model of the true lenses.", group=_ERRORS), _POLYNOMIAL] = (
        None
    )
    extrinsics_mm: Annotated[
        float | None,
        described("Error of the tracking camera's stated position in mm, per axis.", group=_ERRORS),
        limits.POSITION_MM,
    ] = None
    extrinsics_deg: Annotated[
        float | None,
        described("Error of the tracking camera's stated rotation in degrees, per axis.", group=_ERRORS),
        Range(0, 45),
    ] = None
    seed: Seed = 1
    workers: Workers = None
    scheduler: Scheduler = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("viewpoints", "sampling"):
            if self.places is not None and getattr(self, name) != getattr(type(self), name):
                raise BadInputError(f"{flag_of(type(self), name)} has no effect with --places; leave out one.")
        self._check_product(limits.DEPTHS, "distances", "depths_m")
        self._check_product(LIMITS.photographs, "photographs", "viewpoints", "depths_m")

    @property
    def recipe(self) -> SimulationRecipe:
        """Recipe of the simulation: the device and the bench.

        Raises:
            BadInputError: an unknown device or eye, or a faulty file of places.
        """
        places = self._read_places()
        same = {each.name for each in fields(PhotoBenchOptions)} & {each.name for each in fields(self)}
        bench = PhotoBenchOptions(
            camera_px=self.camera,
            tracking_px=self.tracking_camera,
            target_depths_m=self.depths_m,
            places_mm=places,
            imperfections=self._imperfections,
            **{name: getattr(self, name) for name in same},
        )
        return SimulationRecipe(self.device, self.eye, len(places) or self.viewpoints, self.pattern, bench)

    def _read_places(self) -> tuple[tuple[float, float, float], ...]:
        if self.places is None:
            return ()
        reach = half_travel(traced_eye(load_device(self.device), self.eye))
        most = min(int(limits.PLACES.at_most), LIMITS.photographs // len(self.depths_m))
        return tuple((x, y, z) for x, y, z in read_places(self.places, reach, self.stage, most).tolist())

    @property
    def _imperfections(self) -> BenchImperfections:
        """Imperfections of ordinary or perfect equipment, with the sizes given as options."""
        given: dict[str, Any] = {each.name: getattr(self, each.name, None) for each in fields(BenchImperfections)}
        usual = BenchImperfections.none() if self.perfect else BenchImperfections()
        return replace(usual, **{name: size for name, size in given.items() if size is not None})


@job
def simulate(options: SimulateOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Take the photographs; writes them, session.toml, the board and simulation.toml into `options.out`.

    Raises:
        BadInputError: an unknown device or eye, or a folder with a session of other options.
    """
    made = simulate_photo_session(options.out, options.recipe, options.worker_pool, progress)
    too_small = [f"{each} Calibration cannot use them." for each in unreadable_targets(options.recipe.build())]
    return Report(
        f"Simulated session {options.out.name}",
        verdict=f"{made.taken} photographs taken, {made.kept} kept from an earlier run: {options.out}",
        advice=[f"Calibrate with: wlr-render calibrate {options.out}"],
        warnings=[*too_small, *retaken_warnings(made.changed)],
        stem="",
    )


def retaken_warnings(changed: Sequence[Path]) -> list[str]:
    """Return a warning on photographs of an earlier run that had been changed since."""
    if not changed:
        return []
    return [f"{changed[0]}: this photograph, one of {len(changed)}, had changed; they were taken again."]
