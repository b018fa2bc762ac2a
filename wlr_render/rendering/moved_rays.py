"""World rays in (a, b, c, d) form, told in another camera frame."""

import numpy as np

from wlr_render.numerics.arrays import Float32Array, FloatArray


def seen_from(bend: Float32Array, image_from_field: FloatArray) -> Float32Array:
    """The same rays in the frame of another camera.

    With X = O + l D, O = (c, d, 0) and D = (a, b, -1), the transform gives O' = R O + t and D' = R D; D' is scaled to
    D'_z = -1 and O' slid along it to z = 0.

    Args:
        bend: (4, rows, columns), as `RayField.bend`.
        image_from_field: rigid, from the camera frame of `bend` to the other, (4, 4), or (rows, 4, 4) with one for
            each row.

    Returns:
        (4, rows, columns) of the type of `bend`; NaN where a ray does not lead forwards in the other frame.
    """
    entries = np.moveaxis(np.asarray(image_from_field, bend.dtype), (-2, -1), (0, 1))[..., None]
    a, b, c, d = bend
    direction = [row[0] * a + row[1] * b - row[2] for row in entries[:3]]
    origin = [row[0] * c + row[1] * d + row[3] for row in entries[:3]]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(direction[2] < 0, -direction[2], np.nan)
        tangents = [direction[0] / depth, direction[1] / depth]
    offset = [origin[axis] + origin[2] * tangents[axis] for axis in range(2)]
    return np.asarray(np.stack([*tangents, *offset]), bend.dtype)
