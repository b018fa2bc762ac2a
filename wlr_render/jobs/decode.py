"""Decode photographs of a panel or projector that shows a code, and assess the result."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.code_files import CodeFiles, find_code_files
from wlr_render.captures.decoded import Decoded, DecodeOptions, Rejection
from wlr_render.captures.patterns.bit_strength import WEAK, BitStrength, bit_strengths
from wlr_render.captures.patterns.catalogue import make_pattern
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import file_note
from wlr_render.errors import BadInputError
from wlr_render.evaluation.code_quality import NO_LENSES, TOLERANCE_PX, Lenses, PlaneSurvey, find_planes, fit_planes
from wlr_render.io.atomic_files import output_folder, write_arrays, write_figure
from wlr_render.io.input_files import prefix_errors
from wlr_render.io.toml_files import read_toml
from wlr_render.jobs import limits
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Against, Code, Options, ProgressArgument, Range, described, described_size
from wlr_render.mappings import Panel
from wlr_render.report.blocks import Block, Columns, Picture, Report, ReportTable, table
from wlr_render.work.progress import SILENT, Progress

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ACCEPTED, _DARK = "#e4ebdd", "#202020"
_BLOCK_PX = 4  # side of a block, in camera pixels, that one point of the residual picture averages
_RANGE_PX = 0.75  # residual, in panel pixels, at the ends of the colour scale


@dataclass(frozen=True)
class DecodeVerbOptions(Options):
    """Options of `decode`."""

    folder: Annotated[Path, described("Folder of photographs, one for each picture shown, in the order of showing.")]
    _: KW_ONLY
    panel: Annotated[
        tuple[int, int], described_size("Pixels of the panel or projector, e.g. 1920x1080."), limits.PIXELS
    ]
    pattern: Annotated[Code, described("Code that was shown.")] = "gray-fringes"
    bits: Annotated[int, described("Bits of the camera."), Range(8, 16)] = 8
    camera: Annotated[
        Path | None,
        described("TOML file with the format of the camera's files (docs/photo-session.md), in place of --bits."),
    ] = None
    order: Annotated[
        Literal["as shown", "opencv"],
        described("Order of the photographs: white and black first, or last as in OpenCV's Gray code."),
    ] = "as shown"
    out: Annotated[Path, described("Output folder.")] = Path("out/decode")
    against: Against = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.camera is not None and self.bits != type(self).bits:
            raise BadInputError(f"--bits {self.bits} and --camera {self.camera} both state the bits; leave out --bits.")


@dataclass(frozen=True, eq=False)
class CodePhotographs:
    """Photographs of one pattern, with the settings for decoding them."""

    folder: Path
    files: CodeFiles
    pattern: Pattern
    kind: PhotographFormat

    @property
    def options(self) -> DecodeOptions:
        """Decoding limits that the camera sets."""
        return DecodeOptions(self.kind.full_scale, end_of_scale=self.files.end_of_scale(self.kind))


@job
def decode(options: DecodeVerbOptions, *, progress: ProgressArgument = SILENT) -> Report:
    """Decode and assess; writes decoded.npz, pictures and the report into `options.out`.

    Raises:
        BadInputError: photographs are missing or do not decode (see `Pattern.decode`).
    """
    pattern = make_pattern(options.pattern, Panel(*options.panel))
    files = find_code_files(options.folder, pattern.names(), options.order)
    codes = CodePhotographs(options.folder, files, pattern, _camera_format(options))
    report, *_ = decode_and_assess(codes, options.out, progress)
    return report


def decode_and_assess(
    codes: CodePhotographs, out: Path, progress: Progress, lenses: Lenses = NO_LENSES
) -> tuple[Report, Decoded, PlaneSurvey]:
    """Decode photographs, and write decoded.npz and pictures; `lenses` undistort pixels to fit flat surfaces.

    Raises:
        BadInputError: the photographs do not decode, or the folder cannot be written.
    """
    progress.say("decoding")
    with prefix_errors(codes.folder):
        decoded = codes.pattern.decode(codes.files.read(codes.kind), codes.options)
    folder = output_folder(out)
    names = ("pixel", "sigma_px", "confidence", "rejection", "noise_px", "cell_px")
    arrays = write_arrays(folder / "decoded.npz", {name: getattr(decoded, name) for name in names})
    progress.say("fitting flat surfaces")
    survey = fit_planes(decoded, find_planes(decoded, lenses), lenses)
    strengths = bit_strengths(codes.files.read(codes.kind), codes.pattern, codes.options)
    pictures = [
        Picture("Decoded positions", _draw_positions(folder / "positions.png", decoded), "Panel position u and v."),
        Picture("Rejections", _draw_rejections(folder / "rejections.png", decoded), "Reason for each camera pixel."),
        Picture(
            "Residual of flat surfaces",
            _draw_residuals(folder / "residuals.png", survey),
            "Decoded minus predicted, in u and v.",
        ),
    ]
    blocks: list[Block] = [_rejection_table(decoded), _strength_table(strengths), flatness_table(survey), *pictures]
    weak = [bit.name for bit in strengths if bit.weak]
    warnings = [f"Weak bits: {', '.join(weak)}; use the pattern gray-fringes, or more light."] if weak else []
    if missing := [codes.pattern.names()[number] for number in codes.files.missing]:
        warnings.append(f"Decoded without the missing photographs of {', '.join(missing)}.")
    if (light := codes.files.light(codes.kind)) is not None:
        warnings.append(light.note)
    if note := file_note(codes.files.paths[0], codes.kind):
        warnings.append(note)
    report = Report(
        f"Decoded photographs of {codes.folder.name}",
        verdict=f"{np.mean(decoded.accepted):.1%} of the camera's pixels show a panel position.",
        warnings=warnings,
        blocks=blocks,
        inputs=[codes.folder],
        files=[arrays, *(picture.path for picture in pictures)],
    )
    return report, decoded, survey


def _camera_format(options: DecodeVerbOptions) -> PhotographFormat:
    if options.camera is None:
        return PhotographFormat(bits=options.bits)
    table = read_toml(options.camera)
    form = PhotographFormat.from_table(table, options.camera.parent)
    table.finish()
    return form


def _rejection_table(decoded: Decoded) -> ReportTable:
    """Tabulate the number of camera pixels by the result of decoding."""
    counts = [(reason.sentence, count) for reason, count in decoded.counts().items()]
    columns: Columns = {"pixels": int, "share (%)": lambda count: 100.0 * count / decoded.rejection.size}
    return table("Camera pixels", counts, columns, name="result")


def _strength_table(strengths: Sequence[BitStrength]) -> ReportTable:
    """Tabulate the strength of each bit over the lit pixels, and mark weak bits."""
    columns: Columns = {
        "bit": "name",
        "median": "median",
        "5 %": "percentile_5",
        "1 %": "percentile_1",
        "unsure (%)": lambda bit: 100.0 * bit.unsure_share,
        "verdict": lambda bit: "weak" if bit.weak else "",
    }
    notes = (
        "Strength is |picture - inverse| / (white - black) over the well-lit camera pixels; a bit is weak if its "
        f"median is below {WEAK}. Pixels that see a stripe's border are faint in any case.",
    )
    return table("Strength of the bits", strengths, columns, notes)


def flatness_table(survey: PlaneSurvey, title: str = "Homographies of flat surfaces") -> ReportTable:
    """Return the residuals of the homographies of flat surfaces, in panel pixels."""
    columns: Columns = {
        "of accepted (%)": lambda plane: 100.0 * plane.share,
        "rms per axis (px)": "rms_per_axis",
        "median (px)": "residual.median",
        "95 % (px)": "residual.p95",
        "smooth part (px)": "smooth_per_axis",
        "scatter (px)": "scatter_per_axis",
    }
    notes = (
        f"Panel pixels between decoded and predicted; members of a surface lie within {TOLERANCE_PX} px of it.",
        "Smooth part: rms per axis of means over 16 x 16 camera pixels, from lenses and bent surfaces; scatter: "
        "about these means. Whole panel pixels would scatter by 0.29 px.",
    )
    return table(title, enumerate(survey.planes, 1), columns, notes, name="surface")


def _draw_positions(path: Path, decoded: Decoded) -> Path:
    """Draw decoded u and v, side by side."""
    figure, places = _side_by_side(decoded.rejection.shape)
    for axis, (place, name) in enumerate(zip(places, "uv", strict=True)):
        drawn = place.imshow(decoded.pixel[..., axis], cmap="turbo", interpolation="nearest")
        figure.colorbar(drawn, ax=place, label=f"{name} (panel px)", shrink=0.8)
    return write_figure(path, figure, 100)


def _draw_rejections(path: Path, decoded: Decoded) -> Path:
    """Draw the result of decoding for each camera pixel."""
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    colours = rejection_colours()
    height, width = decoded.rejection.shape
    figure = Figure(figsize=(9, 9 * height / width + 1.6), layout="constrained")
    place = figure.add_subplot()
    place.imshow(colours[decoded.rejection], interpolation="nearest")
    place.set(xticks=[], yticks=[])
    shares = ((reason, count / decoded.rejection.size) for reason, count in decoded.counts().items())
    marks = [Patch(color=colours[reason], label=f"{share:.1%} {reason.sentence}") for reason, share in shares]
    figure.legend(handles=marks, loc="outside lower center", ncols=1, fontsize=8)
    return write_figure(path, figure, 100)


def rejection_colours() -> NDArray[np.float64]:
    """Return red, green and blue of each `Rejection`, (number of reasons, 3)."""
    from matplotlib import colormaps
    from matplotlib.colors import to_rgb

    faults = [colormaps["tab10"](number)[:3] for number in range(len(Rejection) - 2)]
    return np.array([to_rgb(_ACCEPTED), to_rgb(_DARK), *faults])


def _draw_residuals(path: Path, survey: PlaneSurvey) -> Path:
    """Draw decoded minus predicted by the surfaces' homographies, in u and v, averaged over small blocks."""
    figure, places = _side_by_side(survey.label.shape)
    means = _block_means(survey.residual)
    for axis, (place, name) in enumerate(zip(places, "uv", strict=True)):
        drawn = place.imshow(means[..., axis], cmap="RdBu", vmin=-_RANGE_PX, vmax=_RANGE_PX, interpolation="nearest")
        place.set_title(f"{name}: decoded - predicted, mean of {_BLOCK_PX} x {_BLOCK_PX} camera pixels", fontsize=9)
        place.set_facecolor("0.75")
    figure.colorbar(drawn, ax=places, label="panel px", extend="both", shrink=0.8)
    return write_figure(path, figure, 100)


def _side_by_side(shape: tuple[int, ...]) -> tuple["Figure", list["Axes"]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 6.5 * shape[0] / shape[1] + 0.8), layout="constrained")
    places = list(figure.subplots(1, 2))
    for place in places:
        place.set(xticks=[], yticks=[])
    return figure, places


def _block_means(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return block means (h / block, w / block, 2) without NaN, omitting incomplete blocks at the right and bottom."""
    rows, columns = (size // _BLOCK_PX for size in values.shape[:2])
    blocks = values[: rows * _BLOCK_PX, : columns * _BLOCK_PX].reshape(rows, _BLOCK_PX, columns, _BLOCK_PX, 2)
    valid = np.isfinite(blocks)
    count = valid.sum(axis=(1, 3))
    sums = np.where(valid, blocks, 0.0).sum(axis=(1, 3))
    return np.where(count > 0, sums / np.maximum(count, 1), np.nan).astype(np.float32)
