"""Simulated photographs: a lens in front of exact optics, a board in the world, a sensor with noise."""
