"""`calibrate`: fit the models of an eye to photographs, captures or a simulated bench."""
