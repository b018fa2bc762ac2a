"""Frames in real time: head pose and eye position in, panel images out, inside anybody's OpenGL program."""
