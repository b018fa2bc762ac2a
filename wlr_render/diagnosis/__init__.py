"""Compare a measured session with its bench model and find the causes of the difference."""
