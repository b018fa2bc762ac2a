"""Camera lens models: directions to pixels and back, with derivatives."""
