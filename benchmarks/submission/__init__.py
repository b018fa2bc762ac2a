"""The CPU cost of submitting frames to the compositor, for each way of using it."""
