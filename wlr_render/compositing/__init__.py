"""Frames in real time: head pose and eye position in, panel images out, inside another OpenGL program."""

from wlr_render.compositing.backend import ComposedFrame
from wlr_render.compositing.compositor import Compositor
from wlr_render.compositing.eye_camera import EyeCamera
from wlr_render.rendering.stored_picture import DepthKind, Rows, StoredDepth

__all__ = ["ComposedFrame", "Compositor", "DepthKind", "EyeCamera", "Rows", "StoredDepth"]
