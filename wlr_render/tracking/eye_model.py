"""Position of the entrance pupil for a gaze direction."""

from dataclasses import dataclass

import numpy as np

from wlr_render.numerics.arrays import FloatArray

PUPIL_DISTANCE_M = 0.0105
"""Rotation centre to entrance pupil: 13.5 mm less 3.05 mm, rounded.

The eye turns about a point 14.8 mm behind the cornea when it turns sideways (Fry & Hill 1962) and 12.2 mm when it turns
up or down (Fry & Hill 1963), 13.5 mm in the mean; the entrance pupil lies 3.05 mm behind the cornea (Gullstrand's
relaxed eye)."""


@dataclass(frozen=True, eq=False)
class RotatingEye:
    """An eye that rotates about a fixed point, with its entrance pupil at a fixed distance in front of that point.

    Attributes:
        rotation_centre_in_device: (3,) metres.
        pupil_distance_m: rotation centre to entrance pupil, along the gaze.
    """

    rotation_centre_in_device: FloatArray
    pupil_distance_m: float = PUPIL_DISTANCE_M

    @classmethod
    def looking_ahead_from(cls, viewpoint_in_device: FloatArray) -> "RotatingEye":
        """Return the eye with its entrance pupil at a viewpoint (3,) when it looks straight ahead, along -z."""
        return cls(np.asarray(viewpoint_in_device, dtype=np.float64) + [0.0, 0.0, PUPIL_DISTANCE_M])

    def viewpoint_of_gaze(self, gaze_dir: FloatArray) -> FloatArray:
        """Return the entrance pupils (..., 3) of unit gaze directions (..., 3), device frame, metres."""
        return np.asarray(self.rotation_centre_in_device + self.pupil_distance_m * np.asarray(gaze_dir))
