"""A small headset with colours."""

import pytest
from small_headsets import changed_device


@pytest.fixture(scope="session")
def prism_of_plastic(tmp_path_factory):
    """Path of a prism whose glass has the colours of PMMA, 320 x 240 pixels."""
    glass = ("index = 1.492", 'formula = "pmma_sultanova_2009"')
    return changed_device(tmp_path_factory.mktemp("device"), "prism5701202", glass, ("[1280, 960]", "[320, 240]"))
