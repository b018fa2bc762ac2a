"""The compositor: warps an engine's pictures to panel images for the current eye and head poses.

A frame is `begin_frame` (returns the cameras), `submit` once per eye (takes the pictures), `compose` (returns the panel
images). Each eye shows its newest submitted picture: one that is late, or drawn at a lower rate, is warped again to the
newest pose. All input is checked before anything is changed: an error leaves the frame as it was before the call.
"""

import typing
import warnings
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Any

import numpy as np

from wlr_render.errors import BadInputError, stacklevel_of_caller
from wlr_render.gl.gl import GlContext
from wlr_render.mappings import Eye
from wlr_render.numerics.arrays import FloatArray
from wlr_render.warp.checks import (
    check_camera_size,
    check_stored,
    check_submitted,
    checked_background,
    checked_choice,
    checked_eye,
    checked_eyes,
    checked_flag,
    checked_models,
    checked_number,
    checked_panels,
    checked_pose,
    checked_quad,
    checked_size,
    checked_viewpoints,
    checked_whole,
    nearest_in_reach,
)
from wlr_render.warp.composed_frame import ComposedFrame
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.frame_handle import FrameHandle, FrameHistory, MotionPredictor, Scan, row_poses
from wlr_render.warp.gl_backend import GlBackend, HiddenAreas, HostState
from wlr_render.warp.gl_cells import MAX_OVERLAYS
from wlr_render.warp.panel_light import SRGB_PANEL, PanelLight
from wlr_render.warp.raster_camera import EyePlan, RasterPlace
from wlr_render.warp.stored_picture import CODES, METRES, PREMULTIPLIED, Rows, StoredColour, StoredDepth
from wlr_render.warp.submitted import pictures_of_eyes


class Compositor:
    """World-locked frames for one or both eyes of a headset, in a new OpenGL context or in the caller's.

    A context manager; `release` frees its objects on the GPU, and the context that it opened.

    Attributes:
        eyes: names of the eyes, left first.
        size_px: (width, height) of each eye's display picture.
    """

    def __init__(
        self,
        models: Eye | Mapping[str, Eye | Sequence[Eye]],
        size: tuple[int, int],
        *,
        context: Any = "auto",
        host_state: HostState = "kept",
        resolution: float = 1.0,
        raster_camera: RasterPlace = "nearest",
        late_margin_deg: float = 1.0,
        background: tuple[int, int, int] = (0, 0, 0),
        panel: PanelLight | Mapping[str, PanelLight] = SRGB_PANEL,
        hidden_areas: HiddenAreas = "repeated",
    ) -> None:
        """Prepare; `prepare` also compiles all shaders.

        Args:
            models: mappings of one eye, or by eye "left" and "right"; three for one eye are for red, green and blue.
            size: (width, height) in pixels of each eye's display picture, which covers its panel; 2^27 pixels at most.
            context: a `moderngl.Context` of the submitted textures, with which the compositor's new context shares
                objects; "current" for the OpenGL context that is current on this thread, whoever made it; "egl" or
                "osmesa" to open a context that shares with none; "auto" for the first of these two that opens; or a
                `gl.gl.GlContext` to work in, which `release` leaves open.
            host_state: state of a given context: "kept" leaves it untouched; "clean" is for drivers that cannot share:
                the compositor works in the host's own context, and the host guarantees OpenGL's default state when it
                calls and relies on no binding afterwards (docs/realtime.md has the list).
            resolution: pixels of the intermediate image per display pixel and axis, 0.01 to 4.
            raster_camera: where `begin_frame` puts the camera: "nearest" to the rays that reach the pupil, or at the
                "viewpoint", as in the paper, from where more is disoccluded. The warp map always comes from the depth
                that you submit: the paper's map from the mesh is not possible here.
            late_margin_deg: largest head rotation between drawing and scan-out without black borders, 0 to 20.
            background: sRGB of pixels that fall outside the picture.
            panel: encoding, uniformity, sub-pixels and bits of the panels' light; one for all eyes, or by eye.
            hidden_areas: content of areas that edges hide from the newest picture (DISOCCLUDED): the colours next to
                them, "repeated", or the eye's "last picture" where it shows them (docs/realtime.md).

        Raises:
            BadInputError: models that do not fit together, an invalid size, or an unknown choice.
            MissingGlError: OpenGL does not open, or the given context cannot share or is below version 4.1.
        """
        channels = checked_models(models)
        self.size_px = checked_size(size)
        resolution = checked_number(resolution, "resolution", 0.01, 4)
        margin = float(np.tan(np.deg2rad(checked_number(late_margin_deg, "late_margin_deg", 0, 20))))
        checked_choice(raster_camera, typing.get_args(RasterPlace), "raster_camera")
        checked_choice(host_state, typing.get_args(HostState), "host_state")
        checked_choice(hidden_areas, typing.get_args(HiddenAreas), "hidden_areas")
        colour = checked_background(background)
        panels = checked_panels(panel, list(channels), self.size_px)
        self._models = channels
        self._plans = {
            eye: EyePlan.of(group, self.size_px, resolution, raster_camera, margin) for eye, group in channels.items()
        }
        for plan in self._plans.values():
            check_camera_size(plan)
        plans = list(self._plans.values())
        self._backend = GlBackend(context, host_state, plans, colour, panels, hidden_areas == "last picture")
        self._predictor = MotionPredictor({eye: group[0].eye_box for eye, group in channels.items()})
        self._history = FrameHistory()
        self._released = False

    @property
    def eyes(self) -> tuple[str, ...]:
        """Names of the eyes, left first."""
        return tuple(self._plans)

    @property
    def renderer(self) -> str:
        """Name of the renderer, e.g. "llvmpipe (LLVM 15.0.6, 256 bits)"."""
        return self._backend.name

    @property
    def context(self) -> GlContext:
        """The compositor's OpenGL context, for use by this library's renderers."""
        return self._backend.context

    def plan(self, eye: str) -> EyePlan:
        """Return the plan of an eye: camera, axes, warp grid."""
        return self._plans[checked_eye(eye, self.eyes)]

    def within_reach(self, eye: str, viewpoint: FloatArray) -> FloatArray:
        """Return the nearest viewpoint (3,) that `begin_frame` accepts, for samples far outside the eye box."""
        return nearest_in_reach(viewpoint, self._models[checked_eye(eye, self.eyes)][0].eye_box)

    def begin_frame(
        self,
        pose: FloatArray,
        viewpoint: FloatArray | Mapping[str, FloatArray],
        *,
        time_s: float | None = None,
        predict_s: float = 0.0,
    ) -> FrameHandle:
        """Start a frame. Pictures of the last three frames may be submitted, in any order of the eyes.

        Only the eyes whose viewpoints are named have a camera in this frame.

        Returns:
            The camera to draw with, by eye, as from `locate_views`: a mapping that is also the handle for `submit`.

        Raises:
            BadInputError: see `locate_views`.
        """
        return self._history.begin(self.locate_views(pose, viewpoint, time_s=time_s, predict_s=predict_s))

    def locate_views(
        self,
        pose: FloatArray,
        viewpoint: FloatArray | Mapping[str, FloatArray],
        *,
        time_s: float | None = None,
        predict_s: float = 0.0,
    ) -> dict[str, EyeCamera]:
        """Return the cameras to draw with, by eye, without starting a frame, as OpenXR's xrLocateViews does.

        An engine that draws a frame for newer poses than it began with gets its cameras here, and passes them to
        `submit`.

        Args:
            pose: (4, 4) world_from_device.
            viewpoint: (3,) entrance pupil in the device frame, metres; by eye if there are two.
            time_s: time of pose and viewpoint in seconds of any clock; for `predict_s`.
            predict_s: time ahead for which to draw, 0 to 0.1 s; pose and viewpoint are predicted at constant velocity
                from this and the last call with a time (`geometry/pose_prediction.py`).

        Raises:
            BadInputError: an invalid pose, viewpoint or time, or a viewpoint far outside the eye box.
        """
        self._check_alive()
        pose, viewpoints = checked_pose(pose), checked_viewpoints(viewpoint, self._models)
        pose, viewpoints = self._predictor.predict(pose, viewpoints, time_s, predict_s)
        return {eye: EyeCamera(eye, self._plans[eye].view(at, pose), at) for eye, at in viewpoints.items()}

    def submit(
        self,
        colour: Any,
        depth: Any = None,
        *,
        eye: str | None = None,
        stored: StoredDepth = METRES,
        rows: Rows | None = None,
        frame: FrameHandle | None = None,
        stored_colour: StoredColour = CODES,
        camera: EyeCamera | Mapping[str, EyeCamera] | None = None,
    ) -> None:
        """Submit the picture of an eye or, as dictionaries by eye, of both, drawn with the cameras of `begin_frame`.

        Args:
            colour: a numpy array (height, width, 3 or 4) of uint8, uint16, float16 or float32 with its top row first;
                or a texture (ModernGL's, its OpenGL number if `depth` is a number too, or a
                `framebuffers.TextureLayer`); or a ModernGL framebuffer, or its OpenGL number, that holds depth too; or
                a `GpuImage` of this library's renderers; only a `GpuImage` is not copied.
            depth: a numpy array (height, width) or a texture, unless `colour` holds it. Pixels with NaN are
                background. Numbers outside the range of `stored` are refused in arrays; in textures, which are not read
                back, they are background too.
            eye: may be omitted if there is one eye, or a camera.
            stored: encoding of the depth; by default metres along the camera's axis with 0 for background, as pyrender
                returns it.
            rows: row that comes first in memory; by default the top row for arrays, the bottom row for OpenGL's
                pictures.
            frame: frame that the picture was drawn for; the newest by default, which is right only while no frames
                overlap: the pose can be checked only for a `GpuImage`.
            stored_colour: encoding of the colours; 8-bit sRGB codes by default.
            camera: camera that drew it, if not the frame's: from `locate_views`, for a pose newer than the frame's; or
                from `EyeCamera.inset`, for a sharper picture of part of the field of view, which replaces the eye's
                picture there. Submit the eye's picture of the frame first, then its insets, each within the last. An
                inset is copied, even a `GpuImage`; without a depth (arrays, ModernGL's textures, `TextureLayer`; a
                number alone means a framebuffer) it takes the depth of the picture around it.

        Raises:
            BadInputError: no frame was begun, or the frame is older than the last three or than the eye's newest
                picture; an eye submitted twice or without a camera in the frame; a picture of another size, kind or
                context; a `GpuImage` of another pose; metres in a depth format; an inset before the eye's picture, of
                another pose, outside the picture before it, or not sharper; or dictionaries of other eyes. If only the
                right eye's picture is refused, the left eye has been submitted.
        """
        handle = self._handle(frame)
        check_stored(stored, stored_colour, rows)
        pictures = pictures_of_eyes(colour, depth, camera, eye, handle, self.eyes)
        with self._backend.working():
            for each in pictures:
                each.show(self._backend.eyes[each.camera.eye], handle, self._history, stored, rows, stored_colour)

    def submit_overlay(
        self,
        picture: Any,
        size_m: tuple[float, float] = (1.0, 1.0),
        *,
        layer: int = 0,
        world_from_quad: FloatArray | None = None,
        device_from_quad: FloatArray | None = None,
        eyes: Sequence[str] | None = None,
        stored_colour: StoredColour = PREMULTIPLIED,
        rows: Rows | None = None,
    ) -> None:
        """Show a flat picture on top, from the next `compose` on, until its layer is replaced or removed.

        Args:
            picture: an array (height, width, 3 or 4), or a texture (ModernGL's, its OpenGL name, or a
                `framebuffers.TextureLayer`), which is copied; None to remove the layer.
            layer: 0 to 3; higher layers are composited over lower ones, whatever their distance.
            size_m: (width, height) of the quad.
            world_from_quad: (4, 4) pose of its middle in the world: x right, y up, seen from +z.
            device_from_quad: alternatively its pose in the device frame, for a quad that moves with the head.
            eyes: eyes that show it, all if None.
            stored_colour, rows: as for `submit`, but premultiplied with alpha by default.

        Raises:
            BadInputError: not exactly one of the two poses, an invalid pose, or a picture of another kind or context.
        """
        self._check_alive()
        chosen = checked_eyes(eyes, self.eyes)
        quad = None if picture is None else checked_quad(size_m, world_from_quad, device_from_quad)
        check_stored(METRES, stored_colour, rows)
        number = checked_whole(layer, "layer", MAX_OVERLAYS - 1)
        with self._backend.working():
            for eye in chosen:
                self._backend.eyes[eye].set_overlay(number, picture, quad, stored_colour, rows)

    def compose(
        self,
        into: Any = None,
        *,
        eyes: Sequence[str] | None = None,
        pose: FloatArray | None = None,
        viewpoint: FloatArray | Mapping[str, FloatArray] | None = None,
        pose_at_last_row: FloatArray | None = None,
        scan: Scan = "down",
        time_s: float | None = None,
        predict_s: float = 0.0,
        with_source: bool = False,
    ) -> ComposedFrame:
        """Return the panel images; may be called again for the same frame with newer poses (late correction).

        Each eye's newest submitted picture is warped with its depth to the newest head pose and viewpoints, in one
        resampling. Without a new picture the last one is shown again.

        Args:
            into: a framebuffer, ModernGL's or its OpenGL number, of the display's size, or by eye; for two eyes also
                one of twice the width, the left eye to the left. Its first colour attachment is drawn to, upright as
                OpenGL shows it, with the panel's codes whatever its format. 0 is the window's framebuffer, and its size
                is not checked. By default, textures of the compositor.
            eyes: eyes to compose, all if None.
            pose: (4, 4) newest world_from_device, when the first row lights up; if None the pose of the newest
                `begin_frame`, even for pictures from a newer `locate_views`.
            viewpoint: newest viewpoints; eyes that are not named keep the viewpoint of the newest `begin_frame`.
            pose_at_last_row: for a display that lights up row by row, the head's pose when the last row lights up.
            scan: "down" if the top row lights up first, "up" if the bottom row does.
            time_s, predict_s: as for `locate_views`; they require `pose`, and `pose_at_last_row` is not predicted.
            with_source: True to add the pull map, `WarpedImage.source`, for eyes without `into`.

        Raises:
            BadInputError: no frame was begun, an eye that was never submitted, a faulty pose, viewpoint or time, or a
                framebuffer of another size, kind or context.
        """
        newest_frame, with_source = self._handle(None), checked_flag(with_source, "with_source")
        checked_choice(scan, typing.get_args(Scan), "scan")
        chosen = checked_eyes(eyes, self.eyes)
        check_submitted(chosen, self._history.shown)
        for eye in chosen:
            self._backend.eyes[eye].check_picture()
        measured = {} if viewpoint is None else checked_viewpoints(viewpoint, self._models)
        newest = newest_frame.world_from_device if pose is None else checked_pose(pose)
        last_row = None if pose_at_last_row is None else checked_pose(pose_at_last_row, "the pose at the last row")
        if pose is None and (time_s is not None or predict_s):
            raise BadInputError("time_s and predict_s are of the pose that compose is given; give pose as well.")
        composed = {}
        with self._backend.working():
            targets = self._backend.targets(into, chosen, self.size_px)
            newest, measured = self._predictor.predict(newest, measured, time_s, predict_s)
            viewpoints = self._history.viewpoints | measured
            with self._backend.together():
                for eye in chosen:
                    grid_rows, height_px = self._plans[eye].warp_grid.grid.rows, self.size_px[1]
                    poses = newest if last_row is None else row_poses(newest, last_row, height_px, grid_rows, scan)
                    to = targets.get(eye)
                    composed[eye] = self._backend.eyes[eye].compose(viewpoints[eye], newest, poses, to, with_source)
            self._backend.show(targets)
            generations = {eye: self._backend.eyes[eye].generation for eye in chosen}

        def reading(eye: str) -> AbstractContextManager[object]:
            self._check_alive()
            return self._backend.reading(eye, generations[eye])

        return ComposedFrame(composed, {eye: viewpoints[eye] for eye in chosen}, newest, reading)

    def prepare(self, overlays: int = 1, insets: bool = False) -> None:
        """Compile all shaders before the first frame: draws once in every mode, which can take a few seconds.

        The small shader of pictures from array textures is compiled when the first one is submitted.

        Args:
            overlays: largest number of overlays that an eye will show at once, 0 to 4; above 0, further shaders are
                compiled.
            insets: whether insets will be submitted.

        Raises:
            BadInputError: `overlays` is not such a number, or `insets` is not True or False.
        """
        self._check_alive()
        count = checked_whole(overlays, "overlays", MAX_OVERLAYS)
        self._backend.prepare(count, checked_flag(insets, "insets"))

    def finish(self) -> None:
        """Block until the GPU is idle. Needed only for timing."""
        self._check_alive()
        self._backend.finish()

    def release(self) -> None:
        """Free all GPU objects and the compositor's context; no frames can be composed afterwards.

        The context of a "clean" host must be current on this thread: otherwise nothing is freed, a RuntimeWarning is
        issued, and `release` may be called again.
        """
        if not self._released and self._backend.release():
            self._released = True
            self._history = FrameHistory()

    def __enter__(self) -> "Compositor":
        self._check_alive()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    def __del__(self) -> None:
        # No OpenGL calls here: Python may call this on any thread, with any context current.
        if not getattr(self, "_released", True) and not self._backend.is_shared:
            message = "a Compositor was not released: call release() or use `with`."
            warnings.warn(message, ResourceWarning, stacklevel=stacklevel_of_caller(), source=self)

    def _check_alive(self) -> None:
        if self._released:
            raise BadInputError("the compositor has been released; make another one.")

    def _handle(self, frame: FrameHandle | None) -> FrameHandle:
        """Return a frame that may be submitted; the newest if None."""
        self._check_alive()
        return self._history.frame(frame)
