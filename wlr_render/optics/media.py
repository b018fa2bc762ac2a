"""Refractive index of the media between surfaces, by wavelength in micrometres."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

FRAUNHOFER_F_D_C_UM = (0.48613270, 0.58756180, 0.65627250)
"""Wavelengths that define an Abbe number: blue (F) and red (C) of hydrogen, and yellow (d) of helium."""
GREEN_UM = 0.55
"""Default wavelength of traces, green."""
INDICES = 1.0, 5.0
"""Smallest and largest refractive index of a transparent medium."""
_DISPLAYED_UM = 0.45, GREEN_UM, 0.65  # wavelengths at which a medium must have a plausible index
_VISIBLE_UM = 0.38, 0.78


@dataclass(frozen=True)
class Medium:
    """A transparent medium: n^2 = 1 + sum of strength L^2 / (L^2 - pole) + sum of factor L^power, and a shift of n.

    Attributes:
        name: name in the device file.
        terms: Sellmeier terms, pairs (strength, pole in square micrometres); a pole of 0 is a constant index, and a
            negative one lies at no real wavelength.
        index_shift: added to n at every wavelength: the difference of a sample from the published formula.
        powers: powers of Schott and Cauchy, pairs (factor in micrometres^-power, power).
    """

    name: str
    terms: tuple[tuple[float, float], ...] = ()
    index_shift: float = 0.0
    powers: tuple[tuple[float, float], ...] = ()

    @classmethod
    def constant(cls, name: str, index: float) -> "Medium":
        """Return a medium without dispersion."""
        return cls(name, ((index * index - 1.0, 0.0),))

    @classmethod
    def squared(
        cls,
        name: str,
        terms: Iterable[tuple[float, float]] = (),
        powers: Iterable[tuple[float, float]] = (),
        fractions: Iterable[tuple[float, float]] = (),
    ) -> "Medium":
        """Return the medium with n^2 = sum of strength L^2 / (L^2 - pole), factor L^power, strength / (L^2 - pole)."""
        terms, powers = list(terms), list(powers)
        for strength, pole in fractions:
            # B / (L^2 - C) is B / C times L^2 / (L^2 - C) - 1.
            terms += [(strength / pole, pole)] if pole else []
            powers.append((-strength / pole, 0.0) if pole else (strength, -2.0))
        constant = sum(factor for factor, power in powers if power == 0.0) - 1.0
        constant += sum(strength for strength, pole in terms if pole == 0.0)
        kept = tuple((strength, pole) for strength, pole in terms if strength and pole)
        if rest := tuple((factor, power) for factor, power in powers if factor and power):
            return cls(name, kept, powers=((constant, 0.0), *rest))
        return cls(name, (*kept, (constant, 0.0)) if constant else kept)

    @classmethod
    def cauchy(cls, name: str, factors: tuple[tuple[float, float], ...]) -> "Medium":
        """Return the medium with n = sum of factor L^power, from pairs (factor, power)."""
        squared: dict[float, float] = {0.0: -1.0}
        for first, p in factors:
            for second, q in factors:
                squared[p + q] = squared.get(p + q, 0.0) + first * second
        return cls(name, powers=tuple((factor, power) for power, factor in sorted(squared.items(), reverse=True)))

    @classmethod
    def abbe(cls, name: str, index: float, number: float, deviation: float = 0.0) -> "Medium":
        """Return the medium with index n_d and Abbe number V_d = (n_d - 1) / (n_F - n_C).

        Three Cauchy terms make both exact. The third follows from the partial dispersion
        P_gF = (n_g - n_F) / (n_F - n_C), which is `deviation` above Schott's normal line 0.6438 - 0.001682 V_d.
        """
        g_line, (f_line, d_line, c_line) = 0.4358343, FRAUNHOFER_F_D_C_UM
        at_g, at_f, at_d, at_c = (np.array([1.0, line**-2, line**-4]) for line in (g_line, f_line, d_line, c_line))
        dispersion = (index - 1.0) / number
        partial = (0.6438 - 0.001682 * number + deviation) * dispersion
        factors = np.linalg.solve(np.stack([at_d, at_f - at_c, at_g - at_f]), [index, dispersion, partial])
        return cls.cauchy(name, tuple(zip(factors.tolist(), (0.0, -2.0, -4.0), strict=True)))

    def shifted(self, delta: float) -> "Medium":
        """Return the same medium with `delta` added to its index at every wavelength."""
        return replace(self, index_shift=self.index_shift + delta)

    def index(self, wavelength_um: float) -> float:
        """Return the refractive index at a vacuum wavelength in micrometres."""
        square = wavelength_um * wavelength_um
        if any(square == pole for _, pole in self.terms):
            return np.nan
        n_squared = 1.0 + sum(strength * square / (square - pole) for strength, pole in self.terms)
        n_squared += sum(factor * wavelength_um**power for factor, power in self.powers)
        # An index is at least 1: beyond a pole it is NaN instead of a complex number.
        return float(n_squared**0.5) + self.index_shift if n_squared >= 0.0 else np.nan

    def fault(self) -> str | None:
        """Describe an index that no transparent medium has in visible light; None if the index is plausible."""
        low, high = INDICES
        for wavelength_um in _DISPLAYED_UM:
            if not low <= (index := self.index(wavelength_um)) <= high:
                return (
                    f"the index at {wavelength_um:g} um is {index:g}; a refractive index lies between {low:g} and "
                    f"{high:g}."
                )
        for strength, pole in self.terms:
            if strength and _VISIBLE_UM[0] ** 2 < pole < _VISIBLE_UM[1] ** 2:
                return (
                    f"the index is infinite at {pole**0.5:.4g} um, in visible light: the pole {pole:g} square "
                    "micrometres is wrong; correct it."
                )
        return None


AIR = Medium("air")
"""The medium at both ends of every path; its index is 1."""
