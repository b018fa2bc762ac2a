"""Scenes, ray maps, warp maps, rasterisation and ray tracing, for any pair of mappings."""
