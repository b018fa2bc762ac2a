"""Camera places that a plan chooses, judged by simulated sessions."""
