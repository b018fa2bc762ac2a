"""From where, and how, an engine has to draw the picture of one eye."""

from dataclasses import dataclass

import numpy as np

from wlr_render.geometry import transforms
from wlr_render.mappings import FloatArray
from wlr_render.rendering.view import View


@dataclass(frozen=True, eq=False)
class EyeCamera:
    """The camera of one eye's intermediate image in one frame: OpenGL's, looking along -z, x right, y up.

    It does not stand at the pupil but where the rays that reach the pupil come from after the combiner has bent them
    (`rendering/raster_eye.py`): what hides what is then nearly as the eye sees it.

    Attributes:
        eye: "left" or "right".
        view: the same in the words of our own renderers.
    """

    eye: str
    view: View

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the picture to draw."""
        return self.view.camera.width_px, self.view.camera.height_px

    @property
    def focal_px(self) -> tuple[float, float]:
        """(fx, fy) in pixels, as in an OpenCV or pyrender intrinsics camera."""
        fx, fy = self.view.camera.focal_px
        return float(fx), float(fy)

    @property
    def centre_px(self) -> tuple[float, float]:
        """(cx, cy): the pixel that looks along -z, from the outer corner of the top left pixel; v runs down."""
        cx, cy = self.view.camera.centre_px
        return float(cx), float(cy)

    @property
    def world_from_camera(self) -> FloatArray:
        """(4, 4) pose in the world, as of a glTF or pyrender camera node."""
        return self.view.world_from_camera

    @property
    def camera_from_world(self) -> FloatArray:
        """(4, 4), OpenGL's view matrix."""
        return transforms.inverse(self.world_from_camera)

    def projection(self, near_m: float, far_m: float = np.inf) -> FloatArray:
        """(4, 4) clip space from the camera frame, OpenGL's: depth -1 at `near_m`, 1 at `far_m`; write its transpose.

        An off-axis frustum (OpenGL 4.6, compatibility profile, 12.1.3 "glFrustum"), and its limit for no far plane.
        """
        (left, bottom), (right, top) = self.view.camera.tangent_min, self.view.camera.tangent_max
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[0, 2] = 2 / (right - left), (right + left) / (right - left)
        matrix[1, 1], matrix[1, 2] = 2 / (top - bottom), (top + bottom) / (top - bottom)
        nearness = near_m / far_m
        matrix[2, 2], matrix[2, 3] = -(1 + nearness) / (1 - nearness), -2 * near_m / (1 - nearness)
        matrix[3, 2] = -1
        return matrix
