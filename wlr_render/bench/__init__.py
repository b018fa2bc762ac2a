"""The nominal bench and its forward model: what calibration starts from and diagnosis predicts with."""
