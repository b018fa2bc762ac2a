"""Every case of the corpus, judged: no traceback, no hang, nothing accepted in silence, nothing left over."""

import pytest

from corpus.all_cases import all_cases
from corpus.base_files import make_bases
from corpus.running import made_once, verdict
from corpus.zygote import Zygote


@pytest.fixture(scope="session")
def bases(tmp_path_factory, worker_id):
    root = tmp_path_factory.getbasetemp()
    return made_once((root if worker_id == "master" else root.parent) / "corpus", make_bases)


@pytest.fixture(scope="session")
def zygote():
    process = Zygote()
    yield process
    process.close()


@pytest.mark.parametrize("case", all_cases(), ids=lambda case: case.name.encode("unicode_escape").decode())
def test_case(case, bases, zygote):
    found, outcome = verdict(zygote, bases, case)
    assert not found, f"{'; '.join(found)}\nwlr-render {' '.join(case.arguments)}\n{outcome.out}{outcome.err}"
