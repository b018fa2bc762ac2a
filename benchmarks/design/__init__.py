"""Camera positions that a plan chooses, judged by simulated sessions."""
