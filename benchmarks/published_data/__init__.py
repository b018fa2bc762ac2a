"""Readers of published measurements for tests and benchmarks; docs/measured-data.md says where to get each set."""
