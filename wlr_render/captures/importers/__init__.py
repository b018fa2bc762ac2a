"""Readers of other people's measurements, one module per format; docs/measured-data.md says where to get each set."""
