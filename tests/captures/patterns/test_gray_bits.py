"""Reading one axis, against what each cell and each misreading means."""

import numpy as np
import pytest

from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.gray_bits import GrayAxis, GrayReading, read_gray
from wlr_render.captures.patterns.photometry import NoiseMeter, PhotographReader, read_light
from wlr_render.numerics.arrays import FloatArray, IntArray

AXIS = GrayAxis("u", 32)


def read(lines: FloatArray) -> GrayReading:
    """Read photographs of one row, given as (pictures, pixels) grey values of the axis."""
    references = [np.full(lines.shape[1], 200), np.zeros(lines.shape[1])]
    photographs = [np.round(line)[None].astype(np.uint8) for line in (*references, *lines)]
    reader = PhotographReader(photographs, ["white", "black", *AXIS.names()])
    light = read_light(reader, DecodeOptions())
    return read_gray(AXIS, reader, light, NoiseMeter(light))


def lines_of(cell: IntArray) -> FloatArray:
    """(pictures, pixels) grey values of pixels that see one cell each."""
    return np.array([AXIS.line(index)[cell] for index in range(2 * AXIS.bits)]) / 255 * 200


def seen(width: float, phase: float) -> FloatArray:
    """(pictures, pixels) grey values of pixels of a width in cells, two cells apart."""
    centre = np.arange(4.0, 28.0, 2.0) + phase
    places = centre[:, None] + width * ((np.arange(60) + 0.5) / 60 - 0.5)
    return np.asarray(lines_of(np.floor(places).astype(int)).mean(axis=-1))


def test_neighbouring_cells_differ_in_one_bit() -> None:
    lines = np.array([AXIS.line(index) for index in range(0, 2 * AXIS.bits, 2)])
    assert (np.count_nonzero(np.diff(lines.astype(int), axis=1), axis=0) == 1).all()


@pytest.mark.parametrize("bit", range(1, 5))
def test_evidence_is_the_faintest_bit_that_could_move_the_cell_by_more_than_one(bit: int) -> None:
    cell = np.arange(32)
    lines = lines_of(cell)
    place = 2 * (AXIS.bits - 1 - bit)
    lines[place : place + 2] = 100 + 0.3 * (lines[place : place + 2] - 100)
    reading = read(lines)
    misread = cell ^ ((1 << (bit + 1)) - 1)  # a wrong bit of Gray code inverts it and all finer bits of the number
    expected = np.where(np.abs(misread - cell) > 1, 0.3, 1.0)
    assert np.array_equal(reading.cell[0], cell)
    np.testing.assert_allclose(reading.evidence[0], expected, atol=1e-6)


@pytest.mark.parametrize(("width", "phase"), [(0.5, 0.2), (1.5, 0.0), (2.0, 0.0), (2.0, 0.5), (2.0, 1.0)])
def test_cells_are_evident_up_to_two_a_pixel_in_any_phase(width: float, phase: float) -> None:
    assert read(seen(width, phase)).evidence.min() > 0.95


def test_the_offset_is_the_mean_of_the_cells_that_a_pixel_sees() -> None:
    part = np.linspace(0, 1, 11)
    for left in range(31):
        lines = lines_of(np.array([left]))[:, 0][:, None] * (1 - part) + lines_of(np.array([left + 1])) * part
        reading = read(lines)
        np.testing.assert_allclose(reading.position[0] - 0.5, left + part, atol=0.01)
