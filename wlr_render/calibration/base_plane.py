"""Choice of the base plane of planar models."""

import numpy as np

from wlr_render.geometry.planes import BasePlane
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray

_FLAT = 0.1  # thickness over extent up to which positions are a plane: thicker layers are spread in depth on purpose
_SPREAD = 0.1  # least extent across the best line over that along it: below, errors of the stage tilt the plane
_STEEPEST = np.tan(np.deg2rad(20.0))  # steepest plane: headsets lean forward by up to some 15 degrees
_LEAST_RISE = 1e-3  # rise over the extent: 0.06 degrees, which no camera position could show
_SIGNIFICANT = 10.0  # F statistic of both slopes: chance exceeds it in one of 1,000 sessions of 25 positions


def choose_base_plane(viewpoint: FloatArray, eye_box: EyeBox) -> BasePlane:
    """Return the base plane of the best conditioning for captures.

    At camera positions in the plane p~ is the position itself: neither the noise of a direction nor the solve mixes
    into it. So it is the least-squares plane through the positions, if they lie in one: tilted if a tilt of up to 20
    degrees is significant, else of constant z. For positions spread in depth it is the plane of constant z through the
    centre of the eye box, where the contraction over the box is smallest: it grows with the distance from the plane.

    Args:
        viewpoint: (n, 3) metres, device frame; repeated positions count once.
        eye_box: box of valid viewpoints.
    """
    position = np.unique(viewpoint, axis=0)
    mean = position[0] + (position - position[0]).mean(axis=0)  # equal coordinates stay what they are
    lateral, rise = (position - mean)[:, :2], (position - mean)[:, 2]
    along, across = (
        np.linalg.svd(lateral, compute_uv=False, full_matrices=True)[:2] if len(position) > 1 else (0.0, 0.0)
    )
    if len(position) > 2 and across > _SPREAD * along:
        slope = np.linalg.lstsq(lateral, rise, rcond=None)[0]
        risen = lateral @ slope
        thickness = np.sqrt(np.sum((rise - risen) ** 2) / max(len(position) - 3, 1))
        extent = across / np.sqrt(len(position))
        flat = thickness <= _FLAT * extent and np.hypot(*slope) <= _STEEPEST
        significant = np.sum(risen**2) > 2 * _SIGNIFICANT * thickness**2
        if flat and significant and np.std(risen) > _LEAST_RISE * extent:
            return BasePlane(float(mean[2] - slope @ mean[:2]), (float(slope[0]), float(slope[1])))
    if len(position) > 1 and np.linalg.norm(rise) <= _FLAT * along:
        return BasePlane(float(mean[2]))
    return BasePlane(float(eye_box.centre[2]))
