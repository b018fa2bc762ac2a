"""Benchmark of a lab in software: codes, calibrations of benches, whole sessions, corrected displays."""
