"""Procedural meshes: plain shapes, the sculpture, things around a desk, the dot board."""
