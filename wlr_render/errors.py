"""The one exception that says "your input is wrong"."""


class BadInputError(ValueError):
    """A fault in what the user gave: one sentence naming the file, the key or the value, and the remedy.

    The command line prints the sentence and ends with status 2; a library caller catches it as a ValueError.
    """


class MissingGlError(BadInputError):
    """OpenGL was asked for and none could be opened; the sentence says what to install or which backend to use."""
