"""Procedural meshes: plain shapes, the sculpture, the dot board."""
