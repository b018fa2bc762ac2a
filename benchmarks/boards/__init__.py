"""Detectors of boards on published photographs."""
