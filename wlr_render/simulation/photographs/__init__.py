"""Photographs in software: a lens before true optics, a board in the world, a sensor with noise."""
