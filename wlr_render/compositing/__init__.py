"""Frames in real time: head pose and eye position in, panel images out, inside another OpenGL program."""
