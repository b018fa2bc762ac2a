"""Head trajectories, gaze and the eye model: from sensors to a viewpoint and a pose."""
