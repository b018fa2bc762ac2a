"""Drawing of scenes: rasterisation, ray and path tracing, layers of frames."""
