"""Scenes: meshes, materials, lights and shapes, and the files of scenes, meshes, images and layers."""
