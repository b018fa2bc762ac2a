"""Errors in arcminutes: of fitted mappings and of images against exact optics."""
