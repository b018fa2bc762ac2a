"""The cases of the corpus, one module for each kind of input."""
