"""The nominal bench, from which calibration starts, and its forward model, with which diagnosis predicts readings."""
