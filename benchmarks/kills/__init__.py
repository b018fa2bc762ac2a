"""Kill jobs at random moments, resume them, and compare the results with those of runs that were left alone."""
