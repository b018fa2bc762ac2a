"""Measured minus simulated: where they differ, why, and what is gained by knowing it."""
