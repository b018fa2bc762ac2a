"""Readers and writers of pictures, maps, trajectories, photographs, boards and sessions, and shipped files.

Files are written whole or not at all. docs/files.md has the formats.
"""

from wlr_render.lazy_names import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from wlr_render.atomic_files import resource as resource
    from wlr_render.bench.bench import Bench as Bench
    from wlr_render.bench.session_folder import save_session as save_session
    from wlr_render.captures.boards.board_file import load_board as load_board
    from wlr_render.captures.boards.board_file import save_board as save_board
    from wlr_render.captures.camera_lens_file import load_lens as load_lens
    from wlr_render.captures.patterns.gray_fringes import GrayFringes as GrayFringes
    from wlr_render.captures.photographs import read_photograph as read_photograph
    from wlr_render.captures.photographs import write_photograph as write_photograph
    from wlr_render.diagnosis.cause import Parameter as Parameter
    from wlr_render.diagnosis.cause import Role as Role
    from wlr_render.diagnosis.cause import changed as changed
    from wlr_render.diagnosis.causes.user_causes import causes_for as causes_for
    from wlr_render.rendering.exr_file import read_exr as read_exr
    from wlr_render.rendering.exr_file import write_exr as write_exr
    from wlr_render.rendering.image_files import read_map as read_map
    from wlr_render.rendering.image_files import read_png as read_png
    from wlr_render.rendering.image_files import write_map as write_map
    from wlr_render.rendering.image_files import write_png as write_png
    from wlr_render.rendering.image_files import write_video as write_video
    from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory as read_eye_trajectory
    from wlr_render.tracking.eye_trajectory_file import write_eye_trajectory as write_eye_trajectory
    from wlr_render.tracking.head_trajectory_file import read_head_trajectory as read_head_trajectory
    from wlr_render.tracking.head_trajectory_file import write_head_trajectory_tum as write_head_trajectory_tum
else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "rendering.image_files": ["read_map", "read_png", "write_map", "write_png", "write_video"],
            "rendering.exr_file": ["read_exr", "write_exr"],
            "tracking.head_trajectory_file": ["read_head_trajectory", "write_head_trajectory_tum"],
            "tracking.eye_trajectory_file": ["read_eye_trajectory", "write_eye_trajectory"],
            "captures.patterns.gray_fringes": ["GrayFringes"],
            "captures.photographs": ["read_photograph", "write_photograph"],
            "captures.boards.board_file": ["load_board", "save_board"],
            "captures.camera_lens_file": ["load_lens"],
            "bench.session_folder": ["save_session"],
            "bench.bench": ["Bench"],
            "diagnosis.cause": ["Parameter", "Role", "changed"],
            "diagnosis.causes.user_causes": ["causes_for"],
            "atomic_files": ["resource"],
        },
    )
