"""Refractive index of the media between surfaces, by wavelength in micrometres."""

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Medium:
    """A transparent medium by its Sellmeier terms: n^2 = 1 + sum of strength * L^2 / (L^2 - pole), and a shift of n.

    Attributes:
        name: what the device file calls it.
        terms: pairs (strength, pole in square micrometres); a pole of 0 is a constant index.
        index_shift: added to n at every wavelength: by how much a sample differs from the published formula.
    """

    name: str
    terms: tuple[tuple[float, float], ...] = ()
    index_shift: float = 0.0

    @classmethod
    def constant(cls, name: str, index: float) -> "Medium":
        """A medium without dispersion."""
        return cls(name, ((index * index - 1.0, 0.0),))

    def shifted(self, delta: float) -> "Medium":
        """The same medium with `delta` added to its index at every wavelength."""
        return replace(self, index_shift=self.index_shift + delta)

    def index(self, wavelength_um: float) -> float:
        """Refractive index at a vacuum wavelength in micrometres."""
        square = wavelength_um * wavelength_um
        n_squared = 1.0 + sum(strength * square / (square - pole) for strength, pole in self.terms)
        return float(n_squared**0.5) + self.index_shift


AIR = Medium("air")
"""Where every path starts and ends; its index is taken as 1."""

FORMULAS = {
    # N. Sultanova, S. Kasarova, I. Nikolov, "Dispersion properties of optical polymers",
    # Acta Physica Polonica A 116 (2009) 585: PMMA.
    "pmma_sultanova_2009": ((1.1819, 0.011313),),
}
"""Sellmeier terms of published formulas, by the name that device files use."""
