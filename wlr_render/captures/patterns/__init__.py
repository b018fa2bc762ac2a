"""Codes shown on a panel. Each family is one file that keeps the law of `pattern.Pattern`."""
