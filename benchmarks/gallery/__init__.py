"""Runs of the main verbs, shown on one page."""
