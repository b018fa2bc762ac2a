"""Decodes a folder of code photographs and judges it: what became of each pixel, which bits are weak, how flat."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wlr_render.captures.decoded import Decoded, DecodeOptions
from wlr_render.captures.importers.procam_graycode import read_procam_graycode
from wlr_render.captures.patterns.gray_bits import bit_strengths
from wlr_render.captures.patterns.gray_code import GrayCode
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.captures.photographs import photographs_in, read_each, read_photograph
from wlr_render.evaluation.code_quality import Lenses, PlaneSurvey, find_planes, fit_planes
from wlr_render.evaluation.opencv_decoder import MISSING, has_opencv_decoder, opencv_codes
from wlr_render.files import output_folder, write_arrays, write_text
from wlr_render.jobs.decode.pictures import draw_positions, draw_rejections, draw_residuals
from wlr_render.jobs.decode.tables import fate_table, flatness_table, no_opencv_table, opencv_table, strength_table
from wlr_render.report.blocks import ReportTable, tables_as_json

_COMPARED = 100_000  # camera pixels that OpenCV's decoder is asked for; it takes them one by one


@dataclass(frozen=True, eq=False)
class CodePhotographs:
    """Photographs of one pattern, in the order of showing, and the lenses that are known."""

    name: str
    photographs: tuple[Path, ...]
    pattern: Pattern
    lenses: Lenses = field(default_factory=Lenses)


@dataclass(frozen=True)
class Result:
    """Tables in the order of telling, and the files written."""

    tables: tuple[ReportTable, ...]
    files: tuple[Path, ...]


def in_folder(folder: Path, pattern: Pattern) -> CodePhotographs:
    """All photographs of a folder, which were taken in the order of the pattern's pictures.

    Raises:
        BadInputError: no such folder, or no photographs in it.
    """
    return CodePhotographs(folder.name, tuple(photographs_in(folder)), pattern)


def of_procam_graycode(folder: Path) -> CodePhotographs:
    """A capture of the procam-calibration project, with its camera and projector.

    Raises:
        BadInputError: as `read_procam_graycode`.
    """
    capture = read_procam_graycode(folder)
    lenses = Lenses(capture.camera, capture.projector)
    return CodePhotographs(folder.name, capture.photographs, GrayCode(capture.panel), lenses)


def run(codes: CodePhotographs, out: Path, options: DecodeOptions | None = None) -> Result:
    """Decode and judge; writes decode.md, decode.json, decoded.npz and three pictures.

    Args:
        codes: what to decode.
        out: folder for the files.
        options: when a camera pixel is believed; without, the usual ones at the full scale of the photographs' bits.

    Raises:
        BadInputError: photographs that do not decode (see `Pattern.decode`), or a place that cannot be written.
    """
    out = output_folder(out)
    options = options or DecodeOptions(int(np.iinfo(read_photograph(codes.photographs[0]).dtype).max))
    decoded = codes.pattern.decode(read_each(codes.photographs), options)
    files = [_write_decoded(out / "decoded.npz", decoded), draw_positions(out / "positions.png", decoded)]
    files.append(draw_rejections(out / "rejections.png", decoded))

    camera_only = Lenses(codes.lenses.camera)
    label = find_planes(decoded, camera_only)
    surveys = {_lens_names(lenses): fit_planes(decoded, label, lenses) for lenses in _variants(codes.lenses)}
    survey = surveys[_lens_names(camera_only)]
    files.append(draw_residuals(out / "residuals.png", survey, f"{codes.name}: {_lens_names(camera_only)}"))

    strengths = bit_strengths(read_each(codes.photographs), codes.pattern, options)
    tables = (
        fate_table(decoded),
        strength_table(strengths),
        flatness_table(surveys),
        _beside_opencv(codes, decoded, survey),
    )
    files.append(write_text(out / "decode.md", "\n".join(table.markdown() for table in tables)))
    files.append(write_text(out / "decode.json", tables_as_json(tables, photographs=codes.name)))
    return Result(tables, tuple(files))


def _beside_opencv(codes: CodePhotographs, decoded: Decoded, survey: PlaneSurvey) -> ReportTable:
    if not isinstance(codes.pattern, GrayCode) or read_photograph(codes.photographs[0]).dtype != np.uint8:
        return no_opencv_table("OpenCV decodes plain Gray code in photographs of 8 bits only.")
    if not has_opencv_decoder():
        return no_opencv_table(MISSING)
    height, width = decoded.rejection.shape
    place = np.random.default_rng(0).choice(height * width, min(_COMPARED, height * width), replace=False)
    pixel = np.stack([place % width, place // width], axis=-1)
    theirs = opencv_codes(read_each(codes.photographs), codes.pattern.panel, pixel)
    return opencv_table(decoded, theirs, place, survey, Lenses(codes.lenses.camera))


def _variants(known: Lenses) -> list[Lenses]:
    """Which lenses to take away: none, then one after the other of those that are known."""
    variants = [Lenses()]
    if known.camera is not None:
        variants.append(Lenses(known.camera))
    if known.projector is not None:
        variants.append(known)
    return variants


def _write_decoded(path: Path, decoded: Decoded) -> Path:
    names = ("pixel", "sigma_px", "confidence", "rejection")
    return write_arrays(path, {name: getattr(decoded, name) for name in names})


def _lens_names(lenses: Lenses) -> str:
    names = [name for name in ("camera", "projector") if getattr(lenses, name) is not None]
    return " and ".join(names) or "none"
