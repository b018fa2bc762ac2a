"""Fits of models to captures, without the exact optics."""
