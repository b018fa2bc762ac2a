"""Bench sessions with an effect hidden in them, made without the package's optics, bench or causes."""
