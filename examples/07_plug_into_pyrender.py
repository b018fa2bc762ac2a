"""A plain pyrender script, and the few lines that make it draw for the panels of a headset."""

import os

os.environ["PYOPENGL_PLATFORM"] = os.environ.get("PYOPENGL_PLATFORM", "egl")  # or osmesa; before pyrender is imported

import numpy as np
import pyrender
import trimesh

import wlr_render as wlr
from wlr_render.files import write_png
from wlr_render.geometry import arcmin_between

scene = pyrender.Scene(bg_color=[0.0, 0.0, 0.0], ambient_light=[0.3, 0.3, 0.3])


def add(shape, rgb, position):
    material = pyrender.MetallicRoughnessMaterial(baseColorFactor=rgb, metallicFactor=0.0, roughnessFactor=1.0)
    pose = trimesh.transformations.translation_matrix(position)
    scene.add(pyrender.Mesh.from_trimesh(shape, material=material, smooth=False), pose=pose)


dot = np.array([0.05, 0.03, -0.9])  # a white dot on a dark board; its error is measured below
add(trimesh.creation.cylinder(radius=0.01, height=0.0005), [1.0, 1.0, 1.0], dot)
add(trimesh.creation.box((3.0, 3.0, 0.02)), [0.05, 0.05, 0.1], dot - [0.0, 0.0, 0.0101])
add(trimesh.creation.box((0.1, 0.1, 0.1)), [0.6, 0.2, 0.1], [-0.1, -0.1, -0.7])
scene.add(pyrender.DirectionalLight(intensity=3.0))
camera = pyrender.IntrinsicsCamera(fx=600, fy=600, cx=320, cy=240)
camera_node = scene.add(camera)
renderer = pyrender.OffscreenRenderer(640, 480)
color, depth = renderer.render(scene)
print(f"pyrender alone: {color.shape[1]} x {color.shape[0]}, nearest at {depth[depth > 0].min():.2f} m")

# ---- plug-in begins ----
models = {eye: wlr.open_eye("northstar", eye) for eye in ("left", "right")}  # or your model.json
head_pose = np.eye(4)  # world_from_device, from your head tracker
pupils = {eye: each.eye_box.centre for eye, each in models.items()}  # device frame, metres, from your eye tracker
with wlr.Compositor(models, size=(1440, 1600), context=os.environ["PYOPENGL_PLATFORM"]) as compositor:
    for eye, wanted in compositor.begin_frame(head_pose, pupils).items():
        renderer.viewport_width, renderer.viewport_height = wanted.size_px
        (camera.fx, camera.fy), (camera.cx, camera.cy) = wanted.focal_px, wanted.centre_px
        scene.set_pose(camera_node, wanted.world_from_camera)
        compositor.submit(*renderer.render(scene), eye=eye)
    frame = compositor.compose()
    panels, unsolved = {eye: frame.read(eye) for eye in frame.eyes}, frame.unsolved()
    drawn_by = compositor.renderer
# ---- plug-in ends ----

renderer.delete()  # after the compositor: on EGL this terminates the display for the whole process
print(f"drawn by {drawn_by}; unsolved rays: {unsolved}")
for eye, picture in panels.items():
    write_png(f"{eye}.png", picture)
    white = picture.min(axis=-1) > 100
    middle = np.argwhere(white).mean(axis=0)[::-1] + 0.5
    seen = models[eye].display.view_dir_of_pixel(middle, pupils[eye]).value
    real = models[eye].see_through.view_dir_of_real_point(dot, pupils[eye]).value
    print(f"{eye} eye: the drawn dot appears {arcmin_between(seen, real):.2f} arcmin from the real one")

# Without a copy to the CPU, pyrender draws in the compositor's context instead of in an OffscreenRenderer:
#     drawing = PyrenderDrawing(compositor.context, scene, camera_node)
#     compositor.submit(drawing.draw_on_gpu(wanted.view, eye), eye=eye)
# It reads depth at the pixel centres. On EGL, OffscreenRenderer reads depth at the first of four samples, 0.4 px off
# the centre, which is visible at silhouettes; with RenderFlags.SEG its depth is correct there.
