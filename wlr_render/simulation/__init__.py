"""Simulated calibration bench: viewpoints, noise, captures, photographs."""
