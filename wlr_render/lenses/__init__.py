"""Lens models of cameras: pixels of directions, and back, with derivatives."""
