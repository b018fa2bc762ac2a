"""Device prescriptions and the exact ray tracer: the truth of simulated headsets."""
