"""The sampling study in parts: trials, their pool, the experiments that they belong to, plots."""
