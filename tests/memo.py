"""Memos of slow functions, for tests that need the same result several times."""

from functools import wraps
from hashlib import sha256
from pickle import dumps


def memoised(function, key=lambda *arguments: arguments):
    """Return the function with a memo of its results, by the bytes of what `key` returns for the arguments."""
    results = {}

    @wraps(function)
    def with_memo(*arguments, **options):
        digest = sha256(dumps(key(*arguments, **options))).digest()
        if digest not in results:
            results[digest] = function(*arguments, **options)
        return results[digest]

    return with_memo
