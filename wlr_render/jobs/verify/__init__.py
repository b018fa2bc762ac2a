"""`verify`: measure the misalignment of dots drawn over a real target."""
