"""Device prescriptions and the exact ray tracer."""
