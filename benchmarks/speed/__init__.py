"""How fast frames are made, against what one would run otherwise: what is timed, how, and what stands beside it."""
