"""Array types, polynomials, least squares, Newton's method and Chebyshev interpolation."""
