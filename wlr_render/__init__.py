"""World-locked rendering for augmented-reality glasses.

    import wlr_render as wlr

    eye = wlr.open_eye("northstar", "right")
    origin, direction, status = wlr.world_rays(eye)

These names, with `wlr_render.engine`, `wlr_render.files` and `wlr_render.geometry`, are the public interface. All other
modules are private and may change. Arrays are in the device frame (OpenXR: x right, y up, looking along -z) and in
metres unless a name says otherwise; (0, 0) is the outer corner of a panel's top-left pixel. Bad input raises
`BadInputError` with one sentence. docs/api.md has a table of all names.
"""

from wlr_render.lazy_names import lazy_names

__version__ = "0.2.0"

TYPE_CHECKING = False
if TYPE_CHECKING:  # imports in the order of the API reference
    # isort: off
    from wlr_render.jobs.headset import open_eye as open_eye
    from wlr_render.mappings import Eye as Eye, Status as Status
    from wlr_render.captures.capture_file import load_captures as load_captures
    from wlr_render.bench.session_folder import load_session as load_session
    from wlr_render.simulation.simulate_captures import simulate as simulate
    from wlr_render.captures.correspondences import Captures as Captures
    from wlr_render.calibration.fit_eye import calibrate as calibrate, Calibration as Calibration
    from wlr_render.evaluation.truth_tests import compare as compare
    from wlr_render.budget.error_map import ErrorMap as ErrorMap
    from wlr_render.budget.error_sizes import ErrorSizes as ErrorSizes
    from wlr_render.diagnosis.procedure import diagnose as diagnose
    from wlr_render.diagnosis.report import Diagnosis as Diagnosis
    from wlr_render.diagnosis.cause import Cause as Cause
    from wlr_render.scene.scene_file import load_scene as load_scene
    from wlr_render.draw.render_frame import render as render
    from wlr_render.draw.painters import Frame as Frame
    from wlr_render.draw.world_rays import world_rays as world_rays
    from wlr_render.exports.export_eye import export as export
    from wlr_render.warp.compositor import Compositor as Compositor
    from wlr_render.warp.warp_mesh import WarpMesh as WarpMesh
    from wlr_render.warp.stored_picture import StoredDepth as StoredDepth
    from wlr_render.tracking.viewpoint_filter import ViewpointFilter as ViewpointFilter
    from wlr_render.tracking.eye_model import RotatingEye as RotatingEye
    from wlr_render.errors import BadInputError as BadInputError
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__, __file__, ("engine", "files", "geometry"))
