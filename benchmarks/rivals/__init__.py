"""Published methods and ours on published measurements, each judged by left-out data."""
