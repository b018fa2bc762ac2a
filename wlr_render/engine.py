"""Names for render engines in addition to `Compositor` and `WarpMesh`.

They cover pictures, panels, trackers, wear and predicted errors.

docs/realtime.md is the guide.
"""

from wlr_render.lazy_names import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from wlr_render.budget.error_map import PredictedError as PredictedError
    from wlr_render.budget.error_sizes import Drawing as Drawing
    from wlr_render.budget.error_sizes import EyeTracker as EyeTracker
    from wlr_render.budget.error_sizes import HeadTracker as HeadTracker
    from wlr_render.budget.error_sizes import Truncation as Truncation
    from wlr_render.budget.registration_budget import RegistrationCovariance as RegistrationCovariance
    from wlr_render.budget.registration_budget import disparity_covariance as disparity_covariance
    from wlr_render.budget.registration_budget import registration_covariance as registration_covariance
    from wlr_render.calibration.self_calibration import PANEL_KEPT as PANEL_KEPT
    from wlr_render.calibration.self_calibration import Clicks as Clicks
    from wlr_render.calibration.self_calibration import WearSettings as WearSettings
    from wlr_render.calibration.self_calibration import WearState as WearState
    from wlr_render.compositing.composed_frame import ComposedFrame as ComposedFrame
    from wlr_render.compositing.eye_camera import EyeCamera as EyeCamera
    from wlr_render.compositing.frame_handle import FrameHandle as FrameHandle
    from wlr_render.evaluation.misalignment import misalignment_arcmin as misalignment_arcmin
    from wlr_render.extras import script_needs as script_needs
    from wlr_render.rendering.framebuffers import TextureLayer as TextureLayer
    from wlr_render.rendering.panel_light import PanelLight as PanelLight
    from wlr_render.rendering.pyrender_drawing import PyrenderDrawing as PyrenderDrawing
    from wlr_render.rendering.ray_map import RayMap as RayMap
    from wlr_render.rendering.ray_map import choose_plan as choose_plan
    from wlr_render.rendering.ray_map import ray_map as ray_map
    from wlr_render.rendering.ray_tracing import EyeView as EyeView
    from wlr_render.rendering.ray_tracing import RayRenderer as RayRenderer
    from wlr_render.rendering.ray_tracing import eye_view as eye_view
    from wlr_render.rendering.scene import Scene as Scene
    from wlr_render.rendering.scene import world_positions as world_positions
    from wlr_render.rendering.stored_picture import DepthKind as DepthKind
    from wlr_render.rendering.stored_picture import Rows as Rows
    from wlr_render.rendering.stored_picture import StoredColour as StoredColour
    from wlr_render.tracking.synthetic import eye_motion as eye_motion
    from wlr_render.tracking.synthetic import head_motion as head_motion
    from wlr_render.tracking.trajectory import EyeTrajectory as EyeTrajectory
    from wlr_render.tracking.trajectory import HeadTrajectory as HeadTrajectory
    from wlr_render.tracking.viewpoint_filter import StreamCounts as StreamCounts
    from wlr_render.tracking.viewpoint_filter import TrackedViewpoint as TrackedViewpoint
    from wlr_render.tracking.viewpoint_filter import TrackingState as TrackingState
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "compositing.composed_frame": ["ComposedFrame"],
            "compositing.eye_camera": ["EyeCamera"],
            "compositing.frame_handle": ["FrameHandle"],
            "rendering.stored_picture": ["DepthKind", "Rows", "StoredColour"],
            "rendering.framebuffers": ["TextureLayer"],
            "rendering.panel_light": ["PanelLight"],
            "rendering.pyrender_drawing": ["PyrenderDrawing"],
            "rendering.ray_map": ["RayMap", "choose_plan", "ray_map"],
            "rendering.ray_tracing": ["EyeView", "RayRenderer", "eye_view"],
            "rendering.scene": ["Scene", "world_positions"],
            "tracking.trajectory": ["EyeTrajectory", "HeadTrajectory"],
            "tracking.synthetic": ["eye_motion", "head_motion"],
            "tracking.viewpoint_filter": ["StreamCounts", "TrackedViewpoint", "TrackingState"],
            "calibration.self_calibration": ["PANEL_KEPT", "Clicks", "WearSettings", "WearState"],
            "budget.error_sizes": ["Drawing", "EyeTracker", "HeadTracker", "Truncation"],
            "budget.error_map": ["PredictedError"],
            "budget.registration_budget": ["RegistrationCovariance", "disparity_covariance", "registration_covariance"],
            "evaluation.misalignment": ["misalignment_arcmin"],
            "extras": ["script_needs"],
        },
    )
