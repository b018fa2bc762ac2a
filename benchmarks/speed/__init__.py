"""Benchmark of speed and accuracy of frames, against baselines."""
