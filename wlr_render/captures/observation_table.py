"""Table of observations: views of the panel and of targets by a camera, with its poses and conditions.

Photographic sessions, bench sessions and simulations all yield this table. Capture files hold it, fits take the
captures of one colour from it, and a diagnosis takes it as a session. Device frame (OpenXR), metres.
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.correspondences import (
    CaptureMotionPrior,
    Captures,
    CommonErrors,
    Conditions,
    DisplayCaptures,
    SeeThroughCaptures,
    concatenate,
    select,
)
from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import BoolArray, FloatArray, IntArray

PANEL_PIXEL, REAL_POINT = 0, 1
"""Kinds of features."""
_GREEN = 1


@dataclass(frozen=True, eq=False)
class ObservationTable:
    """Observations of one eye; a row is the view direction of one feature.

    Attributes:
        device, eye: names.
        panel: the panel whose pixels were decoded; None if unknown.
        eye_box: eye box of the display's observations.
        see_through_eye_box: eye box of the see-through observations; None without any.
        kind: (n,) kind of feature, `PANEL_PIXEL` or `REAL_POINT`.
        capture: (n,) index of the camera place.
        target_pose: (n,) index of the target's pose; -1 for the panel.
        feature: (n, 3) panel pixel u, v and NaN, or a point in the device frame.
        target_point: (n, 3) the point in its target's frame; NaN where unknown, and for the panel.
        viewpoint: (n, 3) the camera's entrance pupil.
        view_dir: (n, 3) unit direction of the feature.
        sigma_arcmin: (n,) standard deviation of `view_dir` about each transverse axis.
        conditions: conditions of each row.
        display_motion, see_through_motion: priors of the camera's motion at each capture or visit; None where unknown.
        display_common, see_through_common: errors that all captures share; None if unknown.

    Raises:
        BadInputError: a column does not fit the others, or holds values that captures refuse.
    """

    device: str
    eye: str
    panel: Panel | None
    eye_box: EyeBox
    see_through_eye_box: EyeBox | None
    kind: IntArray
    capture: IntArray
    target_pose: IntArray
    feature: FloatArray
    target_point: FloatArray
    viewpoint: FloatArray
    view_dir: FloatArray
    sigma_arcmin: FloatArray
    conditions: Conditions
    display_motion: CaptureMotionPrior | None = None
    see_through_motion: CaptureMotionPrior | None = None
    display_common: CommonErrors | None = None
    see_through_common: CommonErrors | None = None

    def __post_init__(self) -> None:
        lengths = {name: len(np.atleast_1d(getattr(self, name))) for name in COLUMNS}
        lengths |= {"conditions": len(self.conditions.visit)}
        if len(set(lengths.values())) > 1:
            raise BadInputError(f"captures: columns differ in length ({lengths}); write the file again.")
        for name in COLUMNS:
            wanted = (len(self), 3) if name in _VECTORS else (len(self),)
            if (shape := np.shape(getattr(self, name))) != wanted:
                raise BadInputError(f"captures: '{name}' must have shape {wanted}, not {shape}; write the file again.")
        if not np.isin(self.kind, (PANEL_PIXEL, REAL_POINT)).all():
            raise BadInputError(f"captures: 'kind' must be {PANEL_PIXEL} (panel pixel) or {REAL_POINT} (real point).")
        if self.panel is None and np.any(self.kind == PANEL_PIXEL):
            raise BadInputError("captures: there are panel pixels, but no 'panel'; state it.")
        if self.see_through_eye_box is None and np.any(self.kind == REAL_POINT):
            raise BadInputError("captures: there are real points, but no 'see_through_eye_box'; state it.")
        # Values that captures refuse are refused here.
        self.display(), self.see_through()

    def __len__(self) -> int:
        return int(np.size(self.kind))

    def display(self, channel: int | None = None) -> DisplayCaptures | None:
        """Return the observations of the panel, in one colour channel or in all; None without any."""
        rows = self.kind == PANEL_PIXEL
        if channel is not None:
            rows = rows & (self.conditions.channel == channel)
        if not rows.any() or self.panel is None:
            return None
        return DisplayCaptures(
            **self._common(rows),
            eye_box=self.eye_box,
            panel=self.panel,
            pixel=self.feature[rows, :2],
            motion=self.display_motion,
            common=self.display_common,
        )

    def see_through(self) -> SeeThroughCaptures | None:
        """Return the observations of real points; None without any."""
        rows = self.kind == REAL_POINT
        if not rows.any() or self.see_through_eye_box is None:
            return None
        return SeeThroughCaptures(
            **self._common(rows),
            eye_box=self.see_through_eye_box,
            point=self.feature[rows],
            target_pose=self.target_pose[rows],
            target_point=self.target_point[rows],
            motion=self.see_through_motion,
            common=self.see_through_common,
        )

    def captures(self) -> Captures:
        """Return the captures for a fit of one wavelength: green if available, else the first colour."""
        channels = np.unique(self.conditions.channel[self.kind == PANEL_PIXEL])
        display = None
        if len(channels):
            display = self.display(_GREEN if _GREEN in channels else int(channels[0]))
        return Captures(display, self.see_through())

    def _common(self, rows: BoolArray) -> dict[str, Any]:
        """Return the attributes that both kinds of captures share."""
        columns = {name: getattr(self, name)[rows] for name in ("viewpoint", "view_dir", "capture", "sigma_arcmin")}
        return columns | {"device": self.device, "eye": self.eye, "conditions": select(self.conditions, rows)}


MOTIONS = ("display_motion", "see_through_motion")
"""Names of the priors of motions in a table."""
COMMONS = ("display_common", "see_through_common")
"""Names of the errors that captures share in a table."""
_HEADER = ("device", "eye", "panel", "eye_box", "see_through_eye_box", "conditions", *MOTIONS, *COMMONS)
_VECTORS = ("feature", "target_point", "viewpoint", "view_dir")
COLUMNS = tuple(each.name for each in fields(ObservationTable) if each.name not in _HEADER)
"""Names of the arrays of a table, without its conditions."""


def observation_table(
    display: DisplayCaptures | None, see_through: SeeThroughCaptures | None, panel: Panel | None = None
) -> ObservationTable:
    """Return captures of one eye as one table; `panel` is used if there are no display captures.

    Raises:
        BadInputError: both are missing, or they are of different eyes.
    """
    first = Captures(display, see_through).source
    parts = [each for each in (display, see_through) if each is not None]
    columns = [_columns(each) for each in parts]
    return ObservationTable(
        device=first.device,
        eye=first.eye,
        panel=panel if display is None else display.panel,
        eye_box=first.eye_box,
        see_through_eye_box=None if see_through is None else see_through.eye_box,
        conditions=concatenate([each.pop("conditions") for each in columns]),
        display_motion=None if display is None else display.motion,
        see_through_motion=None if see_through is None else see_through.motion,
        display_common=None if display is None else display.common,
        see_through_common=None if see_through is None else see_through.common,
        **{name: np.concatenate([each[name] for each in columns]) for name in COLUMNS},
    )


def _columns(captures: DisplayCaptures | SeeThroughCaptures) -> dict[str, Any]:
    count = len(captures)
    nothing: NDArray[np.float64] = np.full((count, 3), np.nan)
    shared = {name: getattr(captures, name) for name in ("capture", "viewpoint", "view_dir", "sigma_arcmin")}
    shared["conditions"] = captures.conditions or Conditions.recorded(count)
    if isinstance(captures, DisplayCaptures):
        feature = np.column_stack([captures.pixel, nothing[:, 0]])
        pose = np.full(count, -1)
        return shared | {
            "kind": pose * 0 + PANEL_PIXEL,
            "target_pose": pose,
            "feature": feature,
            "target_point": nothing,
        }
    on_target = nothing if captures.target_point is None else captures.target_point
    return shared | {
        "kind": np.full(count, REAL_POINT),
        "target_pose": captures.target_pose,
        "feature": captures.point,
        "target_point": on_target,
    }
