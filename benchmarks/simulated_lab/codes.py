"""Codes of a panel as photographed through true optics, decoded, and compared with exact traces."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.intervals import INTERVAL, interval_percent
from benchmarks.simulated_lab import exact_views
from wlr_render.captures.decoded import Decoded
from wlr_render.captures.patterns.catalogue import PATTERNS, make_pattern
from wlr_render.captures.photographs import photographs_in, read_each, write_photograph
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell, ReportTable
from wlr_render.simulation.photographs.camera import Sensor
from wlr_render.simulation.photographs.camera_view import CameraView
from wlr_render.simulation.photographs.photo_bench import PhotoBench

_EVERY = 3  # step along each side: every ninth pixel is compared, enough to find one wrong pixel in ten thousand
_RIM_PX = 4.0  # width of the panel's rim in which blur mixes in the dark surroundings, panel pixels


@dataclass(frozen=True)
class CodeTrial:
    """Result of one code at one signal-to-noise ratio.

    Attributes:
        name: name of the code.
        pictures: number of its pictures.
        compared: number of accepted pixels compared with exact positions.
        rms_px: rms of accepted pixels about the exact position, per axis, less the mean error.
        mean_px: mean of the errors of both axes, caused by aberrations over the finite pupil.
        wrong: number of accepted pixels with an error of more than one panel pixel.
        accepted: accepted share of the camera pixels that see the panel without its rim.
        decode_s: time from files to positions.
        read_s: time to read the files.
    """

    name: str
    pictures: int
    compared: int
    rms_px: float
    mean_px: float
    wrong: int
    accepted: float
    decode_s: float
    read_s: float


def code_trials(bench: PhotoBench, snr: float, seed: int) -> Iterator[CodeTrial]:
    """Yield the result of every code, photographed from the middle of the eye box."""
    device_from_camera = bench.camera_at(np.zeros(3))
    sight = CameraView.through_optics(bench.optics, bench.eyeball, device_from_camera)
    truth = _exact_positions(bench, device_from_camera)
    sensor = Sensor.with_snr(snr, exposure=0.85)
    for name in PATTERNS:
        pattern = make_pattern(name, bench.optics.panel.pixels)
        rng = np.random.default_rng([seed, 5])
        with TemporaryDirectory() as folder:
            for number in range(len(pattern.names())):
                light = sight.panel_light(pattern.image(number)) + 0.03
                write_photograph(Path(folder) / f"{number:03d}.png", sensor.expose(light, rng))
            paths = photographs_in(folder)
            began = time.perf_counter()
            for _ in read_each(paths):
                pass
            read_s = time.perf_counter() - began
            began = time.perf_counter()
            decoded = pattern.decode(read_each(paths))
            decode_s = time.perf_counter() - began
        yield _judged(name, len(paths), decoded, truth, decode_s, read_s)


def code_table(trials: list[CodeTrial], bench: PhotoBench, snr: float) -> ReportTable:
    """Tabulate the codes, one per row."""
    rows: list[list[Cell]] = [
        [
            trial.name,
            trial.pictures,
            trial.compared,
            trial.rms_px,
            trial.mean_px,
            trial.wrong,
            interval_percent(trial.wrong, trial.compared),
            100 * trial.accepted,
            trial.decode_s,
            trial.decode_s / trial.read_s,
        ]
        for trial in trials
    ]
    panel, (width, height) = bench.optics.panel.pixels, bench.eyeball.camera.size_px
    title = (
        f"Codes of {bench.device.name} ({panel.width_px} x {panel.height_px}) by a camera of {width} x {height}, "
        f"8 bits, SNR {snr:g}, pupil {1e3 * bench.eyeball.pupil_diameter_m:g} mm"
    )
    columns = [
        "code",
        "photographs",
        "pixels compared",
        "error rms (panel px, per axis)",
        "mean error (panel px)",
        "wrong by > 1 px",
        INTERVAL,
    ]
    columns += ["accepted (%)", "decoded in (s)", "by reading the files alone"]
    notes = (
        "Against exact traces through the middle of the pupil. Decoding does not cause the mean error: a finite pupil "
        "sees the middle of an aberrated spot. Accepted: of the camera pixels that see the panel without its rim.",
    )
    return ReportTable(title, columns, rows, notes)


def _exact_positions(bench: PhotoBench, device_from_camera: FloatArray) -> FloatArray:
    """Return panel positions (h / every, w / every, 2) of camera pixels; NaN off the panel."""
    width, height = bench.eyeball.camera.size_px
    u, v = np.meshgrid(np.arange(0, width, _EVERY) + 0.5, np.arange(0, height, _EVERY) + 0.5)
    pixel = np.stack([u, v], axis=-1)
    return exact_views.panel_position(bench.optics, bench.eyeball.camera, device_from_camera, pixel).value


def _judged(name: str, pictures: int, decoded: Decoded, truth: FloatArray, decode_s: float, read_s: float) -> CodeTrial:
    shape = decoded.rejection.shape
    inner = np.isfinite(truth).all(axis=-1)
    low, high = np.nanmin(truth, axis=(0, 1)) + _RIM_PX, np.nanmax(truth, axis=(0, 1)) - _RIM_PX
    with np.errstate(invalid="ignore"):
        inner &= np.all((truth > low) & (truth < high), axis=-1)
    some = (slice(0, shape[0], _EVERY), slice(0, shape[1], _EVERY))
    accepted = decoded.accepted[some]
    error = (decoded.pixel[some] - truth)[accepted & inner]
    mean = error.mean(axis=0)
    return CodeTrial(
        name,
        pictures,
        len(error),
        float(np.sqrt(np.mean((error - mean) ** 2))),
        float(np.linalg.norm(mean)),
        int(np.sum(np.linalg.norm(error, axis=1) > 1.0)),
        float(np.mean(accepted[inner])),
        decode_s,
        read_s,
    )
