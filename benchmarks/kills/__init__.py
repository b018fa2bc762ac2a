"""Kill jobs at random moments, resume them, and compare the results with uninterrupted runs."""
