"""Exported files as other programs read them."""
