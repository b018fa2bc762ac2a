"""The on-device experiment: the target drawn over itself, photographed with the display off and on."""
