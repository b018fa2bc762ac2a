"""OpenGL: contexts, programs, framebuffers, and read-back of textures."""
