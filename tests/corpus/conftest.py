"""The valid files that cases spoil, written once in a run of the tests."""

from pathlib import Path

import pytest
from memo import memoised, shared_folder

from corpus.base_files import make_bases


@pytest.fixture(scope="session")
def bases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    shared = shared_folder(tmp_path_factory)
    return memoised(make_bases, shared)(shared / "corpus")
