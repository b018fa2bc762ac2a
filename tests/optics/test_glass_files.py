"""Glasses: the thirteen dispersion formulas of Zemax' catalogues, and the catalogue of this package."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import present

from wlr_render.errors import BadInputError
from wlr_render.optics.glass_files import SHIPPED, shipped_entries, shipped_glasses
from wlr_render.optics.lens_files.glass_catalogues import Glass, GlassCatalogue
from wlr_render.optics.media import AIR, FRAUNHOFER_F_D_C_UM

pytestmark = pytest.mark.usefixtures("without_optiland")

LINES_UM = (0.4, 0.45, 0.5875618, 0.65, 0.7)


def glass(tmp_path: Path, formula: int | str, coefficients: str, more: str = "") -> Glass:
    path = tmp_path / "one.agf"
    path.write_text(f"CC test\nNM ONE {formula} 0 1.5 60 0 0 0\nGC of the test\nCD {coefficients}\n{more}")
    return present(GlassCatalogue((path,)).find("one"))


def schott(powers: tuple[int, ...]) -> Callable[..., Any]:
    return lambda c, L: np.sqrt(sum(value * L**power for value, power in zip(c, powers, strict=True)))


def sellmeier(c: Sequence[float], L: float) -> float:
    return float(np.sqrt(1 + sum(k * L**2 / (L**2 - pole) for k, pole in zip(c[::2], c[1::2], strict=True))))


def herzberger(c: Sequence[float], L: float) -> float:
    m = 1 / (L**2 - 0.028)
    return c[0] + c[1] * m + c[2] * m**2 + c[3] * L**2 + c[4] * L**4 + c[5] * L**6


# Each formula as OpticStudio's help has it, with coefficients of the size that glasses have.
FORMULAS = {
    1: ([2.25, -0.01, 0.011, 2e-4, -1e-5, 1e-6], schott((0, 2, -2, -4, -6, -8))),
    2: ([1.04, 0.006, 0.23, -0.02, 1.01, 103.0], sellmeier),
    3: ([1.5, 0.004, 3e-5, -3e-3, 1e-5, -1e-6], herzberger),
    4: (
        [0.3, 1.0, 0.1, 0.02, 0.15],
        lambda c, L: np.sqrt(1 + c[0] + c[1] * L**2 / (L**2 - c[2] ** 2) + c[3] / (L**2 - c[4] ** 2)),
    ),
    5: ([1.49, 0.009, 5e-4], lambda c, L: c[0] + c[1] / L + c[2] / L**3.5),
    6: ([0.6, 0.005, 0.4, 0.01, 0.2, 0.02, 0.9, 98.0], sellmeier),
    7: ([2.3, 0.02, 0.015, 0.009], lambda c, L: np.sqrt(c[0] + c[1] / (L**2 - c[2]) - c[3] * L**2)),
    8: ([1.3, 1.0, 0.015, 0.009], lambda c, L: np.sqrt(c[0] + c[1] * L**2 / (L**2 - c[2]) - c[3] * L**2)),
    9: (
        [1.2, 1.0, 0.015, 0.9, 95.0],
        lambda c, L: np.sqrt(c[0] + c[1] * L**2 / (L**2 - c[2]) + c[3] * L**2 / (L**2 - c[4])),
    ),
    10: ([2.25, -0.01, 0.011, 2e-4, -1e-5, 1e-6, 1e-8, 1e-9], schott((0, 2, -2, -4, -6, -8, -10, -12))),
    11: ([0.5, 0.005, 0.3, 0.01, 0.2, 0.02, 0.1, 0.03, 0.9, 98.0], sellmeier),
    12: ([2.25, -0.01, 0.011, 2e-4, -1e-5, 1e-6, 1e-4, 1e-5], schott((0, 2, -2, -4, -6, -8, 4, 6))),
    13: ([2.25, -0.01, 1e-4, 0.011, 2e-4, -1e-5, 1e-6, 1e-8, 1e-9], schott((0, 2, 4, -2, -4, -6, -8, -10, -12))),
}


@pytest.mark.parametrize("number", FORMULAS)
def test_every_formula_of_zemax_is_read(tmp_path: Path, number: int) -> None:
    coefficients, expected = FORMULAS[number]
    written = " ".join(map(str, [*coefficients, *[0] * (10 - len(coefficients))]))
    found = glass(tmp_path, number, written).medium
    for wavelength_um in LINES_UM:
        exact = 1e-12 if number != 3 else 1e-7
        assert found.index(wavelength_um) == pytest.approx(expected(coefficients, wavelength_um), abs=exact)


def test_numbers_may_have_decimal_commas(tmp_path: Path) -> None:
    found = glass(tmp_path, "1,0", "2,25 0,0 0 0 0 0", "LD 0,35 2,5")
    assert found == glass(tmp_path, 1, "2.25 0 0 0 0 0", "LD 0.35 2.5")


def test_a_term_without_a_pole_is_a_power(tmp_path: Path) -> None:
    """B / (L^2 - C) with C = 0, in the first formula of the Handbook of Optics."""
    assert glass(tmp_path, 7, "2.3 0.02 0 0.009").medium.index(0.5) == pytest.approx(np.sqrt(2.3 + 0.08 - 0.00225))


# Coefficients and n_d of Ohara's L-BAL35 and S-BSL7; 14 glasses of that catalogue have a negative pole.
@pytest.mark.parametrize(
    ("coefficients", "n_d"),
    [
        ("1.1626263 0.0125957437 0.325661051 -0.0032691105 1.35132486 119.214596", 1.58913),
        ("1.1515019 0.010598413 0.118583612 -0.011822519 1.26301359 129.617662", 1.51633),
    ],
)
def test_a_negative_pole_is_harmless(tmp_path: Path, coefficients: str, n_d: float) -> None:
    assert " -" in coefficients
    assert glass(tmp_path, 2, coefficients).medium.index(FRAUNHOFER_F_D_C_UM[1]) == pytest.approx(n_d, abs=6e-6)


@pytest.mark.parametrize("pole", [0.2304, 0.36, 0.5])
def test_a_pole_in_visible_light_is_refused(tmp_path: Path, pole: float) -> None:
    with pytest.raises(BadInputError, match=r"one\.agf: line 4: glass 'ONE': the index (is infinite )?at"):
        glass(tmp_path, 2, f"1.1 0.01 1e-6 {pole} 0 0")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig", "latin-1"])
def test_catalogues_of_every_encoding(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "one.agf"
    path.write_bytes("CC Gläser\r\nNM EINS 1 0 1.5 60\r\nCD 2.25 0 0 0 0 0\r\n".encode(encoding))
    assert present(GlassCatalogue((path,)).find("Eins")).medium.index(0.5) == 1.5


def test_a_formula_used_beyond_its_range_is_told(tmp_path: Path) -> None:
    found = glass(tmp_path, 1, "2.25 0 0 0 0 0", "LD 0.9 14\n")
    assert found.is_other
    assert found.note == "its formula is stated from 0.9 to 14 um only, and is used beyond them"
    assert not glass(tmp_path, 1, "2.25 0 0 0 0 0", "LD 0.3 2.5\n").note


def test_shipped_glasses_have_the_index_and_abbe_number_of_their_catalogues() -> None:
    """NM has the maker's own n_d and V_d, to the last digit that he states; CD is another line of his catalogue."""
    entries = shipped_entries()
    assert len(entries) >= 60
    stated = [line.split()[1:6] for line in SHIPPED.read_text().splitlines() if line.startswith("NM")]
    for name, _, _, n_d, v_d in stated:
        blue, middle, red = map(shipped_glasses()[name].index, FRAUNHOFER_F_D_C_UM)
        assert middle == pytest.approx(float(n_d), abs=6e-6), name
        assert (middle - 1) / (blue - red) == pytest.approx(float(v_d), abs=0.006), name
        assert entries[name.upper()].source, name
    assert "CC0" in SHIPPED.read_text()


@pytest.mark.parametrize(
    ("name", "n_d"),
    # n_d of data sheets and handbooks, not of the catalogue that is tested
    [
        *(("BK7", 1.5168), ("n-bk7", 1.5168), ("NBK7", 1.5168), ("N_BK7", 1.5168), ("H-K9L", 1.5168)),
        *(("SF11", 1.78472), ("N-SF11", 1.78472), ("F_SILICA", 1.45846), ("C79-80", 1.45846), ("CAF2", 1.43385)),
        *(("PMMA", 1.4918), ("POLYCARB", 1.5855), ("PC", 1.5855), ("POLYSTYR", 1.5905), ("COC", 1.5337)),
        *(("S-LAH64", 1.78800), ("TAFD30", 1.88300), ("B270", 1.5230), ("OKP4", 1.608), ("SAPPHIRE", 1.7682)),
    ],
)
def test_common_names_are_found_without_a_catalogue(name: str, n_d: float) -> None:
    found = GlassCatalogue().find(name)
    assert found is not None
    assert found.medium.index(FRAUNHOFER_F_D_C_UM[1]) == pytest.approx(n_d, abs=1e-4)
    assert "from this program's catalogue (" in found.note
    assert not found.is_other


def test_names_of_other_glasses_are_not_taken_for_those_that_are_shipped() -> None:
    catalogue = GlassCatalogue()
    assert present(catalogue.find("SF11")).medium != present(catalogue.find("N-SF11")).medium
    assert present(catalogue.find("BK7")).note.startswith("taken as N-BK7, ")
    assert present(catalogue.find("F2", ("SCHOTT",))).medium.name == "F2"
    assert catalogue.find("F2", ("CDGM_2022",)) is None
    assert catalogue.find("SF111") is None
    assert present(catalogue.find("VACUUM")).medium is AIR


def test_a_catalogue_of_the_user_comes_before_the_shipped_one(tmp_path: Path) -> None:
    path = tmp_path / "own.agf"
    path.write_text("NM N-BK7 1 0 1.5 60\nCD 2.56 0 0 0 0 0\n")
    found = GlassCatalogue((path,)).find("N-BK7")
    assert found is not None
    assert (found.medium.index(0.5), found.note) == (1.6, "")


def test_of_two_catalogues_with_one_name_that_of_the_lens_file_counts(tmp_path: Path) -> None:
    first, second = tmp_path / "CDGM.agf", tmp_path / "schott.AGF"
    first.write_text("NM F2 1 0 1.5 60\nCD 2.56 0 0 0 0 0\n")
    second.write_text("NM F2 1 0 1.5 60\nCD 2.25 0 0 0 0 0\n")
    catalogue = GlassCatalogue((first, second))
    found = [
        present(catalogue.find("F2", makers)).medium.index(0.5)
        for makers in ((), ("SCHOTT", "CDGM"), ("CDGM", "SCHOTT"))
    ]
    assert found == [1.6, 1.5, 1.6]
