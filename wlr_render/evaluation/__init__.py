"""Errors in arcminutes: mapping against mapping, image against exact optics."""
