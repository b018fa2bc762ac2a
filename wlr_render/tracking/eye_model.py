"""Position of the entrance pupil for a gaze direction, and for view directions off the gaze."""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry.directions import angle_between
from wlr_render.numerics.arrays import FloatArray

PUPIL_DISTANCE_M = 0.0105
"""Rotation centre to entrance pupil: 13.5 mm less 3.05 mm, rounded.

The eye turns about a point 14.8 mm behind the cornea when it turns sideways (Fry & Hill 1962) and 12.2 mm when it turns
up or down (Fry & Hill 1963), 13.5 mm in the mean; the entrance pupil lies 3.05 mm behind the cornea (Gullstrand's
relaxed eye)."""

# Cornea as one sphere, with the iris 3.6 mm and its image 3.05 mm behind it: radius 7.8 mm and iris from Millodot,
# Dictionary of Optometry and Visual Science, optical constants of an average eye; 1.3375 is the index with which
# keratometers convert radii to powers.
_CORNEA_M, _IRIS_M, _INDEX = 7.8e-3, 3.6e-3, 1.3375
_IRIS_FROM_CENTRE_M = _CORNEA_M - _IRIS_M
_PUPIL_FROM_CENTRE_M = _CORNEA_M - 1.0 / (_INDEX / _IRIS_M - (_INDEX - 1.0) / _CORNEA_M)
_STEPS = 6  # steps of Newton's method; the last changes the angle by 1e-15
_MOST_ANGLE = np.deg2rad(90.0)


def entrance_pupil_shift(gaze_dir: FloatArray, view_dir: FloatArray) -> FloatArray:
    """Return the shifts (..., 3) of the entrance pupil for view directions off the gaze, metres.

    The cornea refracts oblique rays more than its power implies: light from a direction off the gaze passes through the
    middle of the iris if it aims at a point in front of the entrance pupil. The shift is perpendicular to the view
    direction: 0.009 mm at 20 degrees, 0.07 mm at 40. By the reversal of rays, a camera sees the entrance pupil with the
    shift for the direction towards the camera.

    A ray that leaves the middle of the iris at the angle u to the axis passes the cornea's centre at n b sin u, with
    the index n and the distance b from iris to centre, and leaves the eye at u - asin(b sin u / R) + asin(n b sin u /
    R). Newton's method solves this for u.

    Args:
        gaze_dir: (..., 3) unit, the axis of the eye.
        view_dir: (..., 3) unit, up to 90 degrees from the gaze.
    """
    angle = np.minimum(angle_between(gaze_dir, view_dir), _MOST_ANGLE)
    sine = np.sin(angle)
    ratio = _IRIS_FROM_CENTRE_M / _CORNEA_M
    inside = angle / (1.0 + (_INDEX - 1.0) * ratio)
    for _ in range(_STEPS):
        a, b = ratio * np.sin(inside), _INDEX * ratio * np.sin(inside)
        slope = 1.0 + ratio * np.cos(inside) * (_INDEX / np.sqrt(1.0 - b**2) - 1.0 / np.sqrt(1.0 - a**2))
        inside = inside - (inside - np.arcsin(a) + np.arcsin(b) - angle) / slope
    size = _INDEX * _IRIS_FROM_CENTRE_M * np.sin(inside) - _PUPIL_FROM_CENTRE_M * sine
    across = gaze_dir - np.sum(gaze_dir * view_dir, axis=-1, keepdims=True) * view_dir
    return np.asarray(np.where(sine > 0.0, size / np.where(sine > 0.0, sine, 1.0), 0.0)[..., None] * across)


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

    def viewpoint_of_gaze(self, gaze_dir: FloatArray, view_dir: FloatArray | None = None) -> FloatArray:
        """Return the entrance pupils (..., 3) of unit gaze directions (..., 3), device frame, metres.

        Args:
            gaze_dir: (..., 3) unit.
            view_dir: (..., 3) unit directions of the light, for which corneal refraction moves the pupil
                (`entrance_pupil_shift`); the gaze itself by default.
        """
        gaze_dir = np.asarray(gaze_dir)
        viewpoint = self.rotation_centre_in_device + self.pupil_distance_m * gaze_dir
        return np.asarray(viewpoint if view_dir is None else viewpoint + entrance_pupil_shift(gaze_dir, view_dir))
