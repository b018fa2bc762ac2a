"""Benchmarks of the program. Not installed: they run from a checkout, as `python -m benchmarks NAME`."""

import sys
from pathlib import Path

# The second tracer and the generator of hidden effects belong to the tests, in `oracle`.
_TESTS = str(Path(__file__).resolve().parent.parent / "tests")
if _TESTS not in sys.path:
    sys.path.append(_TESTS)
