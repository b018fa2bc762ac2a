"""Joint adjustment of a photographic bench: lenses, board, target poses, stage and every photograph's offset."""
