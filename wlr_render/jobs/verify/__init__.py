"""`verify`: draw the target over itself and measure how far the drawn dots lie from the real ones."""
