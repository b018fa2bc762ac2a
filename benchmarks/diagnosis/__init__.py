"""Benchmark of diagnoses: simulated sessions with known hidden effects."""
