"""Whole jobs that the command line runs: alignment demo, sampling study, sequences, benchmarks."""
