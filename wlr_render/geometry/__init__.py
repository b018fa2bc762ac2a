"""Transforms, rays, planes, directions, the pinhole camera: layer 0, knows no optics."""
