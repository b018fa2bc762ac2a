"""`evaluate`: compare model types and numbers of camera positions on simulated captures."""
