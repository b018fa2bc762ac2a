"""The compositor: warps an engine's pictures to panel images for the current eye and head poses.

A frame is `begin_frame` (from where to draw), `submit` once per eye (what was drawn), `compose` (what the panels show).
All input is checked before anything is changed: after an error the frame stands as it did before the call.
"""

import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any

import numpy as np

from wlr_render.compositing.backend import Backend, ComposedFrame, open_backend
from wlr_render.compositing.checks import (
    checked_background,
    checked_eye,
    checked_models,
    checked_pose,
    checked_size,
    checked_viewpoints,
    nearest_in_reach,
)
from wlr_render.compositing.eye_camera import EyeCamera
from wlr_render.compositing.rolling_scanout import row_poses
from wlr_render.errors import BadInputError
from wlr_render.mappings import EyeMappings
from wlr_render.numerics.arrays import FloatArray
from wlr_render.rendering.raster_camera import EyePlan, RasterPlace
from wlr_render.rendering.stored_picture import Rows, StoredDepth
from wlr_render.rendering.view import image_from_ray_map

METRES = StoredDepth()


@dataclass(eq=False)
class _OpenFrame:
    """A frame between `begin_frame` and the next one; `submitted` has, by eye, the texture that was not copied."""

    world_from_device: FloatArray
    viewpoints: dict[str, FloatArray]
    cameras: dict[str, EyeCamera]
    submitted: dict[str, Any] = field(default_factory=dict)


class Compositor:
    """World-locked frames for one or both eyes of a headset, in a context of its own or in yours.

    A context manager; `release` frees what it made on the GPU, and its own context.

    Attributes:
        eyes: names, the left eye first.
        size_px: (width, height) of each eye's display picture.
    """

    def __init__(
        self,
        models: EyeMappings | Mapping[str, EyeMappings | Sequence[EyeMappings]],
        size: tuple[int, int],
        *,
        context: Any = "auto",
        solve: str = "auto",
        resolution: float = 1.0,
        raster_camera: RasterPlace = "nearest",
        late_margin_deg: float = 1.0,
        background: tuple[int, int, int] = (0, 0, 0),
    ) -> None:
        """Prepare; the first compose of each kind (into a framebuffer or not, rolling or not) compiles its shader.

        Args:
            models: mappings of one eye, or by eye "left" and "right"; three of an eye are for red, green and blue.
            size: (width, height) in pixels of each eye's display picture, which covers its panel.
            context: a `moderngl.Context` to work in; "current" for the OpenGL context that is current on this thread,
                whoever made it; "egl" or "osmesa" for one of our own; "cpu" for none; "auto" for the first of these
                three that works here.
            solve: "pixels" (every display pixel, planar models only), "nodes" (a grid of measured error, read
                bilinearly), or "auto": pixels for planar models on a GPU, nodes elsewhere.
            resolution: pixels of the intermediate image per display pixel and axis.
            raster_camera: where `begin_frame` puts the camera: "nearest" to the rays that reach the pupil, or at the
                "viewpoint", as in the paper, from where more is disoccluded. The warp map always comes from the depth
                that you submit: the paper's map from the mesh is not possible here.
            late_margin_deg: how far the head may turn between drawing and scan-out before the borders go black.
            background: sRGB of pixels that see nothing of the picture.

        Raises:
            BadInputError: models that do not fit together, no size, an unknown choice, or pixels for models that are
                not planar.
            MissingGlError: OpenGL was asked for by name and does not open, or a context of yours is below version 4.3.
        """
        channels = checked_models(models)
        self.size_px = checked_size(size)
        if not (0 < resolution <= 4 and 0 <= late_margin_deg <= 20):
            raise BadInputError(
                f"resolution {resolution} and late_margin_deg {late_margin_deg}: give 0 to 4, and 0 to 20 degrees."
            )
        self._models = channels
        margin = float(np.tan(np.deg2rad(late_margin_deg)))
        places = typing.get_args(RasterPlace)
        if raster_camera not in places:
            raise BadInputError(f"raster_camera '{raster_camera}': choose from {', '.join(places)}.")
        self._plans = {
            eye: EyePlan.of(group, self.size_px, resolution, raster_camera, margin) for eye, group in channels.items()
        }
        colour = checked_background(background)
        self._backend: Backend = open_backend(context, list(self._plans.values()), solve, colour)
        self._frame: _OpenFrame | None = None
        self._released = False

    @property
    def eyes(self) -> tuple[str, ...]:
        """Names, the left eye first."""
        return tuple(self._plans)

    @property
    def renderer(self) -> str:
        """Name of the renderer, e.g. "llvmpipe (LLVM 15.0.6, 256 bits)" or "cpu"."""
        return self._backend.name

    @property
    def context(self) -> Any:
        """The `rendering.gl.GlContext` in which it works, for renderers of ours; None without OpenGL."""
        return self._backend.context

    def plan(self, eye: str) -> EyePlan:
        """The plan of an eye: camera, axes, warp grid."""
        return self._plans[checked_eye(eye, self.eyes)]

    def within_reach(self, eye: str, viewpoint: FloatArray) -> FloatArray:
        """Return the nearest viewpoint (3,) that `begin_frame` accepts, for samples far outside the eye box."""
        return nearest_in_reach(viewpoint, self._models[checked_eye(eye, self.eyes)][0].eye_box)

    def begin_frame(self, pose: FloatArray, viewpoint: FloatArray | Mapping[str, FloatArray]) -> dict[str, EyeCamera]:
        """Start a frame and drop the pictures submitted before.

        Args:
            pose: (4, 4) world_from_device.
            viewpoint: (3,) entrance pupil in the device frame, metres; by eye if there are two.

        Returns:
            The camera to draw with, by eye.

        Raises:
            BadInputError: an invalid pose or viewpoint, or a viewpoint far outside the eye box.
        """
        self._check_alive()
        pose, viewpoints = checked_pose(pose), checked_viewpoints(viewpoint, self._models)
        cameras = {eye: EyeCamera(eye, plan.view(viewpoints[eye], pose)) for eye, plan in self._plans.items()}
        self._frame = _OpenFrame(pose, viewpoints, cameras)
        return dict(cameras)

    def submit(
        self,
        color: Any,
        depth: Any = None,
        *,
        eye: str | None = None,
        stored: StoredDepth = METRES,
        rows: Rows | None = None,
    ) -> None:
        """Submit the picture of an eye, drawn with the camera that `begin_frame` returned.

        Args:
            color: a numpy array (height, width, 3 or 4) uint8 sRGB with its top row first; or a ModernGL texture; or a
                ModernGL framebuffer, or the OpenGL number of one, that holds depth too; or a `GpuImage` of our own
                renderers, which alone is not copied. Numbers from 0 to 1 in textures are sRGB codes over 255: linear
                light must be encoded first.
            depth: a numpy array (height, width) or a texture, unless `color` holds it.
            eye: may be left out if there is one eye.
            stored: what the depth means; metres along the camera's axis with 0 for nothing if left out, as pyrender
                gives them.
            rows: which row comes first in memory; the top one for arrays, the bottom one for what OpenGL drew, if left
                out.

        Raises:
            BadInputError: no frame begun, an eye submitted twice, or a picture of another size, kind or context.
        """
        frame, eye = self._begun(), checked_eye(eye, self.eyes)
        if not isinstance(stored, StoredDepth) or not isinstance(rows, Rows | None):
            raise BadInputError("stored must be a StoredDepth, and rows one of Rows; see rendering/stored_picture.py.")
        if eye in frame.submitted:
            raise BadInputError(f"the {eye} eye was submitted already in this frame; call begin_frame for the next.")
        not_copied = getattr(color, "colour", None)  # of a GpuImage
        if not_copied is not None and any(not_copied is other for other in frame.submitted.values()):
            raise BadInputError(
                f"the {eye} eye's picture has overwritten the other eye's; draw each under a name of its own, as in "
                "draw_on_gpu(view, eye)."
            )
        with self._backend.working():
            self._backend.eyes[eye].set_picture(color, depth, stored, rows)
        frame.submitted[eye] = not_copied

    def compose(
        self,
        into: Any = None,
        *,
        pose: FloatArray | None = None,
        viewpoint: FloatArray | Mapping[str, FloatArray] | None = None,
        pose_at_last_row: FloatArray | None = None,
        with_source: bool = False,
    ) -> ComposedFrame:
        """Return the panel images; may be called again for the same frame with newer poses (late correction).

        The submitted pictures are warped with their depth to the newest head pose and viewpoints, in one resampling.

        Args:
            into: a framebuffer, ModernGL's or its OpenGL number, of the display's size, or by eye; for two eyes also
                one of twice the width, the left eye to the left. Its first colour is drawn to, upright as OpenGL shows
                it, with sRGB codes whatever its format. 0 is the window's, whose size is not checked. Textures of our
                own if None.
            pose: (4, 4) newest world_from_device, when the first row lights up; that of `begin_frame` if None.
            viewpoint: newest viewpoints; those of `begin_frame` if None.
            pose_at_last_row: for a display that lights up row by row, the head's pose when the last row does.
            with_source: also make the pull map, `WarpedImage.source`, where there is no `into`.

        Raises:
            BadInputError: no frame begun, an eye not submitted, a faulty pose or viewpoint, or a framebuffer of another
                size, kind or context.
        """
        frame = self._begun()
        missing = [eye for eye in self.eyes if eye not in frame.submitted]
        if missing:
            raise BadInputError(f"the {missing[0]} eye has not been submitted; submit every eye before compose.")
        viewpoints = frame.viewpoints if viewpoint is None else checked_viewpoints(viewpoint, self._models)
        newest = frame.world_from_device if pose is None else checked_pose(pose)
        poses = newest
        if pose_at_last_row is not None:
            poses = row_poses(newest, checked_pose(pose_at_last_row, "pose at the last row"), self.size_px[1])
        composed = {}
        with self._backend.working():
            targets = self._backend.targets(into, self.eyes, self.size_px)
            for eye, plan in self._plans.items():
                view, at = frame.cameras[eye].view, viewpoints[eye]
                moved = image_from_ray_map(view, at, plan.device_from_camera, poses)
                composed[eye] = self._backend.eyes[eye].compose(at, moved, targets.get(eye), with_source)
        return ComposedFrame(composed, self._check_alive)

    def forget(self) -> None:
        """Solve the next frame without a warm start, as after a change of the headset's fit."""
        self._check_alive()
        for eye in self._backend.eyes.values():
            eye.forget()

    def finish(self) -> None:
        """Block until the GPU is idle. Needed only for timing."""
        self._check_alive()
        self._backend.finish()

    def release(self) -> None:
        """Free all GPU objects and an own context; no frames can be composed afterwards.

        Nothing else frees the objects in an adopted context.
        """
        if not self._released:
            self._frame, self._released = None, True
            self._backend.release()

    def __enter__(self) -> "Compositor":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def _check_alive(self) -> None:
        if self._released:
            raise BadInputError("the compositor has been released; make another one.")

    def _begun(self) -> _OpenFrame:
        self._check_alive()
        if self._frame is None:
            raise BadInputError("there is no frame; call begin_frame first.")
        return self._frame
