"""Work on a Dask cluster of local workers: speed, and what a million frames and fits cost."""
