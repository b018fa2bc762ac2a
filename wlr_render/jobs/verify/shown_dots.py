"""Which dots of the target a panel can show whole: those that its edge cuts are found beside their place."""

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.targets.dot_board import DotBoard
from wlr_render.geometry import transforms
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray

_AROUND = 1.3  # of a dot's radius: some white has to be seen around it
_RING = 12
_EDGE_PX = 2.0  # panel pixels


def wholly_shown(
    models: EyeMappings, board: DotBoard, device_from_target: FloatArray, viewpoint: FloatArray
) -> NDArray[np.bool_]:
    """(rows, columns) which dots lie on the panel with what is around them, by the models that draw them.

    Args:
        models: of the eye.
        board: the target.
        device_from_target: (4, 4) where it is drawn.
        viewpoint: (3,) for which it is drawn.
    """
    index = board.indices()
    angle = np.linspace(0.0, 2.0 * np.pi, _RING, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(_RING)], axis=-1)
    radius = 0.5 * _AROUND * board.diameter_of(index)
    point = transforms.apply(device_from_target, board.point_of(index)[:, None] + radius[:, None, None] * ring)
    seen = models.see_through.view_dir_of_real_point(point, viewpoint)
    shown = models.display.pixel_of_view_dir(seen.value, viewpoint)
    with np.errstate(invalid="ignore"):
        inside = (shown.value > _EDGE_PX) & (shown.value < models.display.panel.size_px - _EDGE_PX)
    whole = np.all(inside & (seen.usable & shown.usable)[..., None], axis=(1, 2))
    return np.asarray(whole.reshape(board.rows, board.columns))
