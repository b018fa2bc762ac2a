"""Poses in files: a rotation matrix under one key, a translation under another."""

from wlr_render.geometry.transforms import is_rotation, rigid
from wlr_render.io.file_records import Key, Keys, Rule

ROTATION = Rule("a rotation matrix (orthogonal to 1e-6, determinant +1)", is_rotation)


def pose_keys(rotation: Key, translation: Key) -> Keys:
    """Return the pair of keys that stores a pose (4, 4) in a record."""
    return Keys((rotation, translation), rigid, lambda pose: (pose[:3, :3], pose[:3, 3]))
