"""Transforms, rays, planes, directions and cameras, without domain knowledge."""
