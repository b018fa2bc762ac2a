"""Monado as the reader of our distortion."""
