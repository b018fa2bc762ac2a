"""Printed targets: their design, and detection and identification of their dots in photographs."""
