import pytest


@pytest.fixture
def without_optiland(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same answers where Optiland's catalogue of glasses is installed and where it is not."""
    monkeypatch.setattr("wlr_render.optics.lens_files.glass_catalogues._glass_of_optiland", lambda name, makers: None)
