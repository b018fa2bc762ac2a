"""Frames in real time: head pose and eye position in, panel images out, inside another OpenGL program."""

from wlr_render.compositing.composed_frame import ComposedFrame
from wlr_render.compositing.compositor import Compositor
from wlr_render.compositing.eye_camera import EyeCamera
from wlr_render.compositing.frame_handle import FrameHandle
from wlr_render.compositing.warp_mesh import WarpMesh
from wlr_render.rendering.framebuffers import TextureLayer
from wlr_render.rendering.panel_light import PanelLight
from wlr_render.rendering.stored_picture import DepthKind, Rows, StoredColour, StoredDepth

__all__ = [
    "ComposedFrame",
    "Compositor",
    "DepthKind",
    "EyeCamera",
    "FrameHandle",
    "PanelLight",
    "Rows",
    "StoredColour",
    "StoredDepth",
    "TextureLayer",
    "WarpMesh",
]
