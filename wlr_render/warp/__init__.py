"""Warp of rendered images to panels: ray maps, warp grids, and the compositor of a render engine."""
