"""The camera with which an engine draws one eye's intermediate image, in OpenGL's and OpenXR's terms."""

from dataclasses import dataclass

import numpy as np
import scipy

from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.checks import check_inset_field, checked_flag, checked_fov, checked_size
from wlr_render.warp.stored_picture import check_planes
from wlr_render.warp.view import View


@dataclass(frozen=True, eq=False)
class EyeCamera:
    """The camera of one eye's intermediate image in one frame: OpenGL's, looking along -z, x right, y up.

    By default its position is not the pupil but the apparent origin of the rays that the combiner bends to the pupil
    (`warp/raster_camera.py`): occlusions are then nearly the same as for the eye.

    Attributes:
        eye: "left" or "right".
        view: the same camera, as our own renderers take it.
        viewpoint: (3,) pupil for which it was located, in the device frame, metres.
    """

    eye: str
    view: View
    viewpoint: FloatArray

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
        """(4, 4) pose in the world, as of a glTF or pyrender camera node; read-only."""
        return self.view.world_from_camera

    @property
    def position(self) -> FloatArray:
        """(3,) position in the world, metres: `position` of XrView's pose; read-only."""
        return self.view.position_in_world

    @property
    def orientation_xyzw(self) -> FloatArray:
        """(4,) unit quaternion x, y, z, w of the rotation from camera to world: `orientation` of XrView's pose."""
        return np.asarray(scipy.spatial.transform.Rotation.from_matrix(self.world_from_camera[:3, :3]).as_quat())

    @property
    def camera_from_world(self) -> FloatArray:
        """(4, 4), OpenGL's view matrix."""
        return transforms.inverse(self.world_from_camera)

    @property
    def fov_rad(self) -> tuple[float, float, float, float]:
        """Angles of the left, right, upper and lower border from straight ahead, in the order of XrFovf."""
        (left, down), (right, up) = np.arctan([self.view.camera.tangent_min, self.view.camera.tangent_max])
        return float(left), float(right), float(up), float(down)

    def inset(self, fov_rad: tuple[float, float, float, float], size_px: tuple[int, int]) -> "EyeCamera":
        """Return the camera of an inset, a sharper picture of a part of its field: `Compositor.submit(camera=...)`.

        It has this camera's pose, so that one view matrix serves for both.

        Args:
            fov_rad: angles of the left, right, upper and lower border, as `fov_rad`. The inset blends into the picture
                around it over a tenth of its shorter side.
            size_px: (width, height) of the inset.

        Raises:
            BadInputError: invalid angles or size, a field of view not within this one, or an inset that is not sharper.
        """
        width, height = checked_size(size_px)
        left, right, up, down = np.tan(checked_fov(fov_rad))
        camera = Pinhole(width, height, np.array([left, down]), np.array([right, up]))
        check_inset_field(camera, self.view.camera)
        view = self.view
        inset = View(camera, view.position_in_device, view.world_from_device, view.device_from_camera)
        return EyeCamera(self.eye, inset, self.viewpoint)

    def projection(self, near_m: float, far_m: float = np.inf, zero_to_one: bool = False) -> FloatArray:
        """Return the matrix (4, 4) from the camera frame to clip space; OpenGL takes its transpose.

        An off-axis frustum (OpenGL 4.6, compatibility profile, 12.1.3 "glFrustum"), or its limit for a plane that is
        infinitely far. A depth buffer then is `StoredDepth(DepthKind.WINDOW, near_m, far_m)`.

        Args:
            near_m: distance that the depth buffer stores as 0.
            far_m: distance that it stores as 1; nearer than `near_m` for a reversed buffer.
            zero_to_one: True if clip space has depths from 0 to 1, as after glClipControl, in Vulkan and in Direct3D;
                else from -1 to 1.

        Raises:
            BadInputError: the distances are not two different positive ones.
        """
        check_planes(near_m, far_m)
        checked_flag(zero_to_one, "zero_to_one")
        (left, bottom), (right, top) = self.view.camera.tangent_min, self.view.camera.tangent_max
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[0, 2] = 2 / (right - left), (right + left) / (right - left)
        matrix[1, 1], matrix[1, 2] = 2 / (top - bottom), (top + bottom) / (top - bottom)
        scale = 1 / (1 / far_m - 1 / near_m)
        matrix[2, 2:] = scale / near_m, scale
        if not zero_to_one:
            matrix[2, 2:] = 2 * matrix[2, 2] + 1, 2 * matrix[2, 3]
        matrix[3, 2] = -1
        return matrix
