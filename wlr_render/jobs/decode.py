"""Decode photographs of a panel or projector that shows a code, and assess the result."""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Literal

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
from wlr_render.io.atomic_files import output_folder, write_arrays, write_figure
from wlr_render.io.input_files import prefix_errors
from wlr_render.io.toml_files import read_toml
from wlr_render.jobs import limits
from wlr_render.jobs.job import job
from wlr_render.jobs.options import Against, Code, Options, ProgressArgument, Range, described, described_size
from wlr_render.mappings import Panel
from wlr_render.report.blocks import Block, Columns, Picture, Report, ReportTable, table
from wlr_render.work.progress import SILENT, Progress

_ACCEPTED, _DARK = "#e4ebdd", "#202020"


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
    return decode_and_assess(codes, options.out, progress)[0]


def decode_and_assess(codes: CodePhotographs, out: Path, progress: Progress) -> tuple[Report, Decoded]:
    """Decode photographs, and write decoded.npz and pictures.

    Raises:
        BadInputError: the photographs do not decode, or the folder cannot be written.
    """
    progress.say("decoding")
    with prefix_errors(codes.folder):
        decoded = codes.pattern.decode(codes.files.read(codes.kind), codes.options)
    folder = output_folder(out)
    names = ("pixel", "sigma_px", "confidence", "rejection", "noise_px", "cell_px")
    arrays = write_arrays(folder / "decoded.npz", {name: getattr(decoded, name) for name in names})
    strengths = bit_strengths(codes.files.read(codes.kind), codes.pattern, codes.options)
    pictures = [
        Picture("Decoded positions", _draw_positions(folder / "positions.png", decoded), "Panel position u and v."),
        Picture("Rejections", _draw_rejections(folder / "rejections.png", decoded), "Reason for each camera pixel."),
    ]
    blocks: list[Block] = [_rejection_table(decoded), _strength_table(strengths), *pictures]
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
    return report, decoded


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


def _draw_positions(path: Path, decoded: Decoded) -> Path:
    """Draw decoded u and v, side by side."""
    from matplotlib.figure import Figure

    height, width = decoded.rejection.shape
    figure = Figure(figsize=(14, 6.5 * height / width + 0.8), layout="constrained")
    for axis, (place, name) in enumerate(zip(figure.subplots(1, 2), "uv", strict=True)):
        place.set(xticks=[], yticks=[])
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
