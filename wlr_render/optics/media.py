"""Refractive index of the media between surfaces, by wavelength in micrometres."""

from dataclasses import dataclass, replace

import numpy as np

FRAUNHOFER_F_D_C_UM = (0.48613270, 0.58756180, 0.65627250)
"""Blue and red of hydrogen, yellow of helium between them: the lines that an Abbe number is stated for."""


@dataclass(frozen=True)
class Medium:
    """A transparent medium: n^2 = 1 + sum of strength L^2 / (L^2 - pole) + sum of factor L^power, and a shift of n.

    Attributes:
        name: what the device file calls it.
        terms: of Sellmeier, pairs (strength, pole in square micrometres); a pole of 0 is a constant index.
        index_shift: added to n at every wavelength: by how much a sample differs from the published formula.
        powers: of Schott and Cauchy, pairs (factor in micrometres^-power, power).
    """

    name: str
    terms: tuple[tuple[float, float], ...] = ()
    index_shift: float = 0.0
    powers: tuple[tuple[float, float], ...] = ()

    @classmethod
    def constant(cls, name: str, index: float) -> "Medium":
        """A medium without dispersion."""
        return cls(name, ((index * index - 1.0, 0.0),))

    @classmethod
    def cauchy(cls, name: str, factors: tuple[tuple[float, float], ...]) -> "Medium":
        """A medium of n = sum of factor L^power, from pairs (factor, power)."""
        squared: dict[float, float] = {0.0: -1.0}
        for first, p in factors:
            for second, q in factors:
                squared[p + q] = squared.get(p + q, 0.0) + first * second
        return cls(name, powers=tuple((factor, power) for power, factor in sorted(squared.items(), reverse=True)))

    @classmethod
    def abbe(cls, name: str, index: float, number: float) -> "Medium":
        """A medium by its index n_d and its Abbe number V_d = (n_d - 1) / (n_F - n_C).

        Both are met exactly, by three terms of Cauchy; the third is that of a normal glass, whose partial dispersion
        (n_g - n_F) / (n_F - n_C) lies on Schott's normal line 0.6438 - 0.001682 V_d.
        """
        g_line, (f_line, d_line, c_line) = 0.4358343, FRAUNHOFER_F_D_C_UM
        at_g, at_f, at_d, at_c = (np.array([1.0, line**-2, line**-4]) for line in (g_line, f_line, d_line, c_line))
        dispersion = (index - 1.0) / number
        partial = (0.6438 - 0.001682 * number) * dispersion
        factors = np.linalg.solve(np.stack([at_d, at_f - at_c, at_g - at_f]), [index, dispersion, partial])
        return cls.cauchy(name, tuple(zip(factors.tolist(), (0.0, -2.0, -4.0), strict=True)))

    def shifted(self, delta: float) -> "Medium":
        """The same medium with `delta` added to its index at every wavelength."""
        return replace(self, index_shift=self.index_shift + delta)

    def renamed(self, name: str) -> "Medium":
        """The same medium by another name."""
        return replace(self, name=name)

    def index(self, wavelength_um: float) -> float:
        """Refractive index at a vacuum wavelength in micrometres."""
        square = wavelength_um * wavelength_um
        if any(square == pole for _, pole in self.terms):
            return np.nan
        n_squared = 1.0 + sum(strength * square / (square - pole) for strength, pole in self.terms)
        n_squared += sum(factor * wavelength_um**power for factor, power in self.powers)
        # The index of no medium is below 1: beyond a pole, NaN instead of a complex number.
        return float(n_squared**0.5) + self.index_shift if n_squared >= 0.0 else np.nan


AIR = Medium("air")
"""Where every path starts and ends; its index is taken as 1."""

FORMULAS = {
    # N. Sultanova, S. Kasarova, I. Nikolov, "Dispersion properties of optical polymers",
    # Acta Physica Polonica A 116 (2009) 585.
    "pmma_sultanova_2009": ((1.1819, 0.011313),),
    "polycarbonate_sultanova_2009": ((1.4182, 0.021304),),
    "polystyrene_sultanova_2009": ((1.4435, 0.020216),),
    # Schott, data sheets of optical glass.
    "n_bk7_schott": ((1.03961212, 0.00600069867), (0.231792344, 0.0200179144), (1.01046945, 103.560653)),
    # I. H. Malitson, "Interspecimen comparison of the refractive index of fused silica",
    # J. Opt. Soc. Am. 55 (1965) 1205.
    "silica_malitson_1965": ((0.6961663, 0.0684043**2), (0.4079426, 0.1162414**2), (0.8974794, 9.896161**2)),
}
"""Sellmeier terms of published formulas, by the name that device files use."""
