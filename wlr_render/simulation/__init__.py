"""A calibration bench in software: viewpoints, noise, simulated captures."""
