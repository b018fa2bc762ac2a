"""Benchmark of a simulated lab: codes, bench calibrations, whole sessions, corrected displays."""
