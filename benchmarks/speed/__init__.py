"""Benchmark of the speed and accuracy of frames, against baselines."""
