"""World-locked rendering for augmented-reality glasses."""

__version__ = "0.2.0"
