"""A small headset with colours, and a small session of photographs."""

import pytest
from small_headsets import changed_device
from small_photo_session import copied, made_session, make_small


@pytest.fixture(scope="session")
def prism_of_plastic(tmp_path_factory):
    """Path of a prism whose glass has the colours of PMMA, 320 x 240 pixels."""
    glass = ("index = 1.492", 'formula = "pmma_sultanova_2009"')
    return changed_device(tmp_path_factory.mktemp("device"), "prism5701202", glass, ("[1280, 960]", "[320, 240]"))


@pytest.fixture(scope="session")
def calibrated_session(tmp_path_factory):
    """A small session of photographs, simulated, and its calibration; nobody writes there."""
    return made_session(tmp_path_factory.mktemp("photographs"))


@pytest.fixture
def photo_session(calibrated_session, tmp_path, monkeypatch):
    """A copy of it to spoil; whatever is simulated or read meanwhile is small and in this process."""
    make_small(monkeypatch)
    return copied(calibrated_session[0], tmp_path)
