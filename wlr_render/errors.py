"""Exceptions for bad input."""


class BadInputError(ValueError):
    """Bad input: one sentence with the file, the key or value, and the remedy.

    The command line prints the sentence and ends with status 2; a library caller catches it as a ValueError.
    """


class MissingGlError(BadInputError):
    """OpenGL is required and cannot be opened; the sentence says what to install or which backend to use."""
