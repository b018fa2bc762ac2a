"""Our decoder of Gray code beside OpenCV's."""
