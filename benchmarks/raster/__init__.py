"""Rasterised frames, with the raster of the paper, against ray-traced ones, pixel by pixel."""
