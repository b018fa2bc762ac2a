"""Readers and writers of pictures, maps, trajectories, photographs, boards and sessions, and shipped files.

Files are written atomically. docs/files.md describes the formats.
"""

from wlr_render.lazy_names import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:  # imports in the order of the API reference
    # isort: off
    from wlr_render.scene.image_files import read_map as read_map, read_png as read_png, write_map as write_map
    from wlr_render.scene.image_files import write_png as write_png, write_video as write_video
    from wlr_render.scene.exr_file import read_exr as read_exr, write_exr as write_exr
    from wlr_render.tracking.head_trajectory_file import read_head_trajectory as read_head_trajectory
    from wlr_render.tracking.head_trajectory_file import write_head_trajectory_tum as write_head_trajectory_tum
    from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory as read_eye_trajectory
    from wlr_render.tracking.eye_trajectory_file import write_eye_trajectory as write_eye_trajectory
    from wlr_render.captures.patterns.catalogue import GrayFringes as GrayFringes
    from wlr_render.captures.photographs import read_photograph as read_photograph, write_photograph as write_photograph
    from wlr_render.captures.boards.board_file import load_board as load_board, save_board as save_board
    from wlr_render.captures.camera_lens_file import load_lens as load_lens
    from wlr_render.bench.session_folder import save_session as save_session
    from wlr_render.bench.bench import Bench as Bench
    from wlr_render.bench.bench_effects import BenchEffect as BenchEffect
    from wlr_render.diagnosis.cause import Parameter as Parameter, Role as Role, changed as changed
    from wlr_render.diagnosis.causes.user_causes import causes_for as causes_for
    from wlr_render.io.atomic_files import resource as resource
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
