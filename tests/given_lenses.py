"""Sessions whose lenses cost little: their kind is stated, and few photographs show them."""

from dataclasses import replace

from wlr_render.simulation.photographs.imperfections import BenchImperfections


def with_stated_lenses(session):
    """Return the session with the kind of its lenses stated and six photographs of each: choosing takes long."""
    cameras = {}
    for name in ("eyeball_camera", "tracking_camera"):
        camera = getattr(session, name)
        cameras[name] = replace(camera, lens=BenchImperfections().lens, intrinsics=camera.intrinsics[2:8])
    return replace(session, **cameras)
