"""Plans of sessions: camera places, predicted errors, and the smallest design that reaches an accuracy."""
