"""Compose the frames of a ModernGL program, which has its own context, shader and framebuffers, for a panel."""

import time

import moderngl
import numpy as np

import wlr_render as wlr
from wlr_render.engine import DepthKind, eye_motion, head_motion
from wlr_render.files import write_png

SIZE, FRAMES, RATE_HZ, NEAR_M = (360, 400), 30, 90.0, 0.05
TO_FIRST_ROW_S, SCAN_OUT_S = 0.010, 0.008  # latency of the panel's first row; time from its first row to its last

# The engine: cubes on a grid, drawn with its own shader.
VERTEX = """
#version 410
uniform mat4 clip_from_world;
out vec3 place;
void main() {
    vec3 corner = vec3(gl_VertexID & 1, gl_VertexID >> 1 & 1, gl_VertexID >> 2) - 0.5;
    place = 0.3 * vec3(gl_InstanceID % 7 - 3, gl_InstanceID / 7 % 5 - 2, -2 - gl_InstanceID / 35) + 0.1 * corner;
    gl_Position = clip_from_world * vec4(place, 1);
}"""
FRAGMENT = """
#version 410
in vec3 place;
out vec4 colour;
void main() { colour = vec4(step(0.5, fract(place * 20 + 0.25)) * 0.7 + 0.3, 1); }"""
CUBE = [0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5]
ctx = moderngl.create_context(standalone=True, backend="egl", require=410)
program = ctx.program(VERTEX, FRAGMENT)
cubes = ctx.vertex_array(program, [], index_buffer=ctx.buffer(np.array(CUBE, np.uint32)))
panel = ctx.framebuffer([ctx.texture(SIZE, 4)])  # replaces a headset's swap chain

eye = wlr.open_eye("northstar")  # or your model.json
centre, duration_s = eye.eye_box.centre, FRAMES / RATE_HZ + 0.1
head, gaze = head_motion(seed=3, duration_s=duration_s), eye_motion({"right": centre}, seed=3, duration_s=duration_s)
tracker = wlr.ViewpointFilter(centre)
compositor = wlr.Compositor(eye, SIZE, context=ctx)

wanted = compositor.begin_frame(head.at(0.0), centre)["right"]
picture = ctx.framebuffer([ctx.texture(wanted.size_px, 4)], ctx.depth_texture(wanted.size_px))
picture.use()  # the engine sets its OpenGL state once, here
ctx.enable(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
ctx.front_face = "cw"


def draw(camera):
    clip_from_world = camera.projection(NEAR_M) @ camera.camera_from_world
    program["clip_from_world"].write(np.ascontiguousarray(clip_from_world.T, np.float32))
    picture.clear()
    cubes.render(instances=105)


draw(wanted)
before, milliseconds, unsolved = picture.read(), [], 0
for number in range(FRAMES):
    t = number / RATE_HZ
    blink = 8 <= number < 20
    viewpoint = tracker.update(t, None if blink else gaze.viewpoint_at("right", t)).viewpoint
    start = time.perf_counter()
    camera = compositor.begin_frame(head.at(t), compositor.within_reach("right", viewpoint))["right"]
    draw(camera)
    compositor.submit(picture, stored=wlr.StoredDepth(DepthKind.WINDOW, NEAR_M, np.inf))
    first_row_s = t + TO_FIRST_ROW_S
    newer = {"pose": head.at(first_row_s), "pose_at_last_row": head.at(first_row_s + SCAN_OUT_S)}
    frame = compositor.compose(into=panel, **newer)
    compositor.finish()
    milliseconds.append(1e3 * (time.perf_counter() - start))
    unsolved += sum(frame.unsolved()["right"].values())

shown = np.frombuffer(panel.read(components=3), np.uint8).reshape(SIZE[1], SIZE[0], 3)
write_png("panel.png", shown[::-1])
print(f"{compositor.renderer}: {FRAMES} frames; {tracker.counts.sentence}; {unsolved} points of the ray map unsolved")
print("milliseconds per frame, 50, 95, 99 %:", *np.percentile(milliseconds, [50, 95, 99]).round(1))
draw(wanted)
left_alone = picture.read() == before and ctx.error == "GL_NO_ERROR"
print("OpenGL state of the engine was", "left alone" if left_alone else "CHANGED")
compositor.release()
