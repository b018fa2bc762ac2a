"""All causes by name. To add a cause, add an entry to the tuple of its subject."""

from wlr_render.diagnosis.causes.optics import FORM, OPTICS, READOUT
from wlr_render.diagnosis.causes.station import CAMERA, MOUNT, RUN_TIME, STAGE, TARGET, TRACKING_CAMERA

_IN_ORDER = (*OPTICS, *FORM, *STAGE, *CAMERA, *TARGET, *TRACKING_CAMERA, *MOUNT, *READOUT, *RUN_TIME)
CAUSES = {cause.name: cause for cause in _IN_ORDER}
