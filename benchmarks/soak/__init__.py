"""A long run of frames for a moving wearer, as a real-time program would draw it."""
