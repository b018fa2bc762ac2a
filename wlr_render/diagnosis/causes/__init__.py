"""All causes by name. A new cause is an entry in the tuple of its subject."""

from wlr_render.diagnosis.causes.form import FORM
from wlr_render.diagnosis.causes.optics import OPTICS, READOUT
from wlr_render.diagnosis.causes.station import CAMERA, MOUNT, STAGE, TARGET
from wlr_render.diagnosis.causes.tracking import RUN_TIME, TRACKING_CAMERA

_IN_ORDER = (*OPTICS, *FORM, *STAGE, *CAMERA, *TARGET, *TRACKING_CAMERA, *MOUNT, *READOUT, *RUN_TIME)
CAUSES = {cause.name: cause for cause in _IN_ORDER}
