"""Monado as a reader of our distortion."""
