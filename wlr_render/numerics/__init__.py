"""Array types, polynomials, least squares, Newton, Chebyshev interpolation: layer 0, knows no geometry."""
