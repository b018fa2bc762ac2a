"""Rasterised frames, as in the paper and by the compositor, against ray-traced frames, pixel by pixel."""
