"""What a calibration bench delivers: correspondences, and the files that hold them."""
