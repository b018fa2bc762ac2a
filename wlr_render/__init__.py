"""World-locked rendering for augmented-reality glasses."""
