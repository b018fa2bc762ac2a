"""Copies of a device with some of its parts changed."""

from wlr_render.optics.device_file import load_device
from wlr_render.optics.media import AIR


def test_media_change_in_both_paths_and_air_stays_air():
    eye = load_device("birdbath28").eyes["right"]
    changed = eye.with_media(lambda medium: medium.shifted(0.02).shifted(-0.005))
    for path, before in ((changed.display, eye.display), (changed.see_through, eye.see_through)):
        for step, old in zip(path.steps, before.steps, strict=True):
            assert step.surface is old.surface
            assert step.interaction is old.interaction
            rise = step.medium.index(0.5) - old.medium.index(0.5)
            assert abs(rise - (0.0 if old.medium is AIR else 0.015)) < 1e-15
            assert step.medium.name == old.medium.name
    assert {step.medium.name for step in changed.display.steps} == {"pmma", "air"}
