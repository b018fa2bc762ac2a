"""Soak test: a long run of real-time frames for a moving wearer."""
