"""The error budget of a headset: covariance of its registration error by source, and statements about it."""
