"""The camera pose and intrinsics of a picture, their file, and the transform of rays to the camera's frame."""

import functools
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.geometry import transforms
from wlr_render.geometry.pinhole import Pinhole
from wlr_render.io.toml_files import write_json
from wlr_render.numerics.arrays import read_only


@dataclass(frozen=True, eq=False)
class View:
    """A pinhole camera in a headset, with the headset's pose in the world.

    Attributes:
        camera: looks along the -z axis of its frame, at the position.
        position_in_device: (3,) metres; a raster camera is not at the pupil.
        world_from_device: (4, 4) head pose.
        device_from_camera: (3, 3) rotation of the camera in the device.
    """

    camera: Pinhole
    position_in_device: NDArray[np.float64]
    world_from_device: NDArray[np.float64]
    device_from_camera: NDArray[np.float64] = field(default_factory=lambda: np.eye(3))

    @functools.cached_property
    def position_in_world(self) -> NDArray[np.float64]:
        """(3,) metres; read-only."""
        return read_only(transforms.apply(self.world_from_device, self.position_in_device))

    @functools.cached_property
    def world_from_camera(self) -> NDArray[np.float64]:
        """(4, 4), read-only; the camera frame's origin is the position."""
        turned = self.world_from_device[:3, :3] @ self.device_from_camera
        return read_only(transforms.rigid(turned, self.position_in_world))


def image_from_ray_map(
    image_view: View,
    viewpoint_in_device: NDArray[np.float64],
    device_from_camera: NDArray[np.float64],
    world_from_device: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the transform (..., 4, 4) from a ray map's camera frame to a picture's camera frame.

    The picture may have been drawn from another position, or for an older head pose: the picture must be sampled along
    a ray of the ray map after this transform.

    Args:
        image_view: view from which the picture was drawn.
        viewpoint_in_device: (3,) or (..., 3) metres.
        device_from_camera: (3, 3) axes of the ray map.
        world_from_device: (4, 4) or (..., 4, 4) head poses, for a whole frame or for each row of the display.
    """
    device_from_rays = transforms.rigid(device_from_camera, viewpoint_in_device)
    return np.asarray(transforms.inverse(image_view.world_from_camera) @ world_from_device @ device_from_rays)


@dataclass(frozen=True, eq=False)
class GeometryImage:
    """A picture with the inverse depth of each pixel. Rows run down, pixel centres at +0.5.

    Attributes:
        colour: (height, width, 3) uint8 sRGB.
        inverse_depth: (height, width) float32, 1 / (distance along the view's -z axis) in 1/m; 0 for background.
    """

    colour: NDArray[np.uint8]
    inverse_depth: NDArray[np.float32]


def write_view(path: str | Path, view: View) -> Path:
    """Write a view as JSON, format `wlr-view` 1: a pinhole's size, focal lengths and centre in pixels, and its pose."""
    camera = view.camera
    record = {
        "format": "wlr-view",
        "version": 1,
        "frame": "openxr",
        "size_px": [camera.width_px, camera.height_px],
        "focal_px": camera.focal_px.tolist(),
        "centre_px": camera.centre_px.tolist(),
        "position_in_device_m": view.position_in_device.tolist(),
        "world_from_camera": view.world_from_camera.tolist(),
    }
    return write_json(path, record)
