"""Fitted maps: planar bundles and the baselines, behind the two protocols, and their file."""
