"""The valid files that cases spoil, written once in a run of the tests."""

import pytest

from corpus.base_files import make_bases
from corpus.running import made_once


@pytest.fixture(scope="session")
def bases(tmp_path_factory, worker_id):
    root = tmp_path_factory.getbasetemp()
    return made_once((root if worker_id == "master" else root.parent) / "corpus", make_bases)
