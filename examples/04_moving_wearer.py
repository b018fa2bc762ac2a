"""Write synthetic head and eye trajectories to files, and draw frames of both eyes along them."""

import wlr_render as wlr
from wlr_render.engine import eye_motion, head_motion
from wlr_render.files import (
    read_eye_trajectory,
    read_head_trajectory,
    write_eye_trajectory,
    write_head_trajectory_tum,
)

eyes = {name: wlr.open_eye("northstar", name) for name in ("left", "right")}
pupils = {name: eye.eye_box.centre for name, eye in eyes.items()}
write_head_trajectory_tum("head.tum", head_motion(seed=4, duration_s=1.0))
write_eye_trajectory("eyes.txt", eye_motion(pupils, seed=4, duration_s=1.0))

# `wlr-render render northstar sculpture --head head.tum --eye-track eyes.txt --eye both` draws the whole sequence.
head, gaze, scene = read_head_trajectory("head.tum"), read_eye_trajectory("eyes.txt"), wlr.load_scene("sculpture")
for time_s in (0.0, 0.5):
    for name, eye in eyes.items():
        frame = wlr.render(eye, scene, gaze.viewpoint_at(name, time_s), head.at(time_s), shadows=False)
        print("wrote", frame.save(f"{name}-{1000 * time_s:.0f}-ms.png"))
