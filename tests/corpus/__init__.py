"""Hostile, damaged and mistaken inputs for every reader and verb, each judged by the same rules."""
