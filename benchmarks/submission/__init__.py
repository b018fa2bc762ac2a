"""Which model of the pupil the decoded captures of a headset from two viewpoints support."""
