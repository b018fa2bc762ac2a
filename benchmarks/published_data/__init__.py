"""Readers of published measurements for tests and benchmarks; docs/measured-data.md lists the sources."""
