"""Warp maps for other programs: one module per file format."""
