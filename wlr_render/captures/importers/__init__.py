"""Readers of published data sets, one module per format; docs/measured-data.md has their sources."""
