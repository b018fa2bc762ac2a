"""The jobs of the verbs: one module or folder each, with options, function and report."""
