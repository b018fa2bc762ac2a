"""Names for render engines in addition to `Compositor` and `WarpMesh`.

They cover pictures, panels, trackers, wear and predicted errors.

docs/realtime.md is the guide.
"""

from wlr_render.lazy_names import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:  # imports in the order of the API reference
    # isort: off
    from wlr_render.warp.composed_frame import ComposedFrame as ComposedFrame
    from wlr_render.warp.eye_camera import EyeCamera as EyeCamera
    from wlr_render.warp.frame_handle import FrameHandle as FrameHandle
    from wlr_render.warp.frame_pacing import FramePacer as FramePacer, FrameTimes as FrameTimes
    from wlr_render.warp.gpu_image import GpuImage as GpuImage
    from wlr_render.warp.warp import WarpStatus as WarpStatus
    from wlr_render.gl.gl_errors import GlError as GlError
    from wlr_render.errors import MissingGlError as MissingGlError
    from wlr_render.warp.stored_picture import DepthKind as DepthKind, Rows as Rows, StoredColour as StoredColour
    from wlr_render.gl.framebuffers import TextureLayer as TextureLayer
    from wlr_render.warp.panel_light import PanelLight as PanelLight
    from wlr_render.draw.pyrender_drawing import PyrenderDrawing as PyrenderDrawing
    from wlr_render.warp.ray_map import RayMap as RayMap, choose_plan as choose_plan, ray_map as ray_map
    from wlr_render.draw.ray_tracing import EyeView as EyeView, RayRenderer as RayRenderer, eye_view as eye_view
    from wlr_render.scene.scene import Scene as Scene, world_positions as world_positions
    from wlr_render.tracking.trajectory import EyeTrajectory as EyeTrajectory, HeadTrajectory as HeadTrajectory
    from wlr_render.tracking.synthetic import eye_motion as eye_motion, head_motion as head_motion
    from wlr_render.tracking.viewpoint_filter import StreamCounts as StreamCounts, TrackedViewpoint as TrackedViewpoint
    from wlr_render.tracking.viewpoint_filter import TrackingState as TrackingState
    from wlr_render.calibration.self_calibration import PANEL_KEPT as PANEL_KEPT, Clicks as Clicks
    from wlr_render.calibration.self_calibration import WearSettings as WearSettings, WearState as WearState
    from wlr_render.budget.error_sizes import Drawing as Drawing, EyeTracker as EyeTracker, HeadTracker as HeadTracker
    from wlr_render.budget.error_sizes import Truncation as Truncation
    from wlr_render.budget.error_map import PredictedError as PredictedError
    from wlr_render.budget.registration_budget import RegistrationCovariance as RegistrationCovariance
    from wlr_render.budget.registration_budget import disparity_covariance as disparity_covariance
    from wlr_render.budget.registration_budget import registration_covariance as registration_covariance
    from wlr_render.evaluation.misalignment import misalignment_arcmin as misalignment_arcmin
    from wlr_render.extras import script_needs as script_needs
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
