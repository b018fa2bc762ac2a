"""Error budget of a headset: covariance of the registration error by source, and figures derived from it."""
