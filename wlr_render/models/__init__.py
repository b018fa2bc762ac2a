"""Fitted mappings: planar models and baselines that implement the two protocols, and their file."""
