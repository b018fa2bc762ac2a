"""Observations of a calibration bench, and their files."""
