"""All causes by name. A new cause is an entry in the tuple of its subject's file."""

from wlr_render.diagnosis.causes import camera, device, run_time, stage, target, tracking

_IN_ORDER = (
    *device.OPTICS,
    *stage.STAGE,
    *camera.CAUSES,
    *target.CAUSES,
    *tracking.CAUSES,
    *stage.MOUNT,
    *device.READOUT,
    *run_time.CAUSES,
)
CAUSES = {cause.name: cause for cause in _IN_ORDER}
