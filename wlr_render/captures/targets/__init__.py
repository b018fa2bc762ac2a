"""Printed targets: what is printed, how it is found in a photograph, and which dot is which."""
