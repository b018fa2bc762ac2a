"""Published methods that a planar model competes with: each fits its own model to the same captures."""
