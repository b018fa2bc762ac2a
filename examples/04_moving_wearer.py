"""Write synthetic head and eye trajectories to files, and draw frames of both eyes along them."""

from pathlib import Path

from wlr_render.jobs.headset import open_eye
from wlr_render.jobs.render import RenderOptions, render
from wlr_render.tracking.eye_trajectory_file import write_eye_trajectory
from wlr_render.tracking.head_trajectory_file import write_head_trajectory_tum
from wlr_render.tracking.synthetic import eye_motion, head_motion

pupils = {eye: open_eye("northstar", eye).eye_box.centre for eye in ("left", "right")}
write_head_trajectory_tum("head.tum", head_motion(seed=4, duration_s=1.0))
write_eye_trajectory("eyes.txt", eye_motion(pupils, seed=4, duration_s=1.0))

options = RenderOptions(
    headset="northstar",
    scene="sculpture",
    head=Path("head.tum"),
    eye_track=Path("eyes.txt"),
    eye="both",
    frame_limit=2,
    out=Path("frames"),
)
print(render(options).verdict)
print("again:", render(options).verdict)
