"""Head trajectories, gaze and the eye model: viewpoints and head poses from sensor data."""
