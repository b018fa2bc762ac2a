"""The pictures of one call of `Compositor.submit`, with the cameras that drew them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import shown
from wlr_render.warp.checks import check_inset_field, checked_choice, checked_eye
from wlr_render.warp.eye_camera import EyeCamera
from wlr_render.warp.frame_handle import FrameHandle, FrameHistory
from wlr_render.warp.gl_backend import GlEye
from wlr_render.warp.gpu_image import GpuImage


@dataclass(frozen=True, eq=False)
class DrawnPicture:
    """Colour and depth as `Compositor.submit` takes them, and the camera that drew them."""

    camera: EyeCamera
    colour: Any
    depth: Any

    def show(self, on: GlEye, handle: FrameHandle, history: FrameHistory, *storage: Any) -> None:
        """Show the picture on its eye from now on; as an inset, over the eye's present pictures.

        Args:
            on: the picture's eye.
            handle: the picture's frame.
            history: the frames of the compositor.
            storage: `stored`, `rows` and `stored_colour` of `Compositor.submit`.

        Raises:
            BadInputError: see `Compositor.submit`.
        """
        view, given = self.camera.view, (self.colour, self.depth, *storage)
        if not on.is_drawn_whole(view):
            history.check_inset(handle, self.camera)
            check_inset_field(view.camera, on.sharpest)
            on.add_inset(view, *given)
            return
        not_copied = self.colour.colour if isinstance(self.colour, GpuImage) else None
        history.check_order(handle, self.camera.eye, not_copied)
        on.set_picture(view, *given)
        history.submitted(handle, self.camera, not_copied)


def pictures_of_eyes(
    colour: Any, depth: Any, camera: Any, eye: str | None, cameras: Mapping[str, EyeCamera], eyes: Sequence[str]
) -> list[DrawnPicture]:
    """Return the pictures of `Compositor.submit`, the left eye's first.

    Args:
        colour, depth, camera, eye: see `Compositor.submit`.
        cameras: cameras of the frame, by eye.
        eyes: names of the compositor's eyes.

    Raises:
        BadInputError: an eye that is not named, or has no camera in the frame; a camera of another eye; or depths and
            cameras that are not given by eye as the colours are.
    """
    if not isinstance(colour, Mapping):
        named = camera.eye if eye is None and isinstance(camera, EyeCamera) else checked_eye(eye, eyes)
        by_eye = {named: (colour, depth, camera)}
    else:
        names = [checked_choice(each, eyes, "an eye of the pictures") for each in colour]
        if not names:
            raise BadInputError("there is no picture; give one for each eye that is submitted.")
        for what, given in (("eye", eye), ("depth", depth), ("camera", camera)):
            is_by_eye = isinstance(given, Mapping) and set(given) == set(names)
            if given is not None and (not is_by_eye or what == "eye"):
                raise BadInputError(
                    f"{what} is {shown(given)}, and the colours are given for {', '.join(names)}; give it by eye too, "
                    "or leave it out."
                )
        chosen = [each for each in eyes if each in names]
        by_eye = {each: (colour[each], (depth or {}).get(each), (camera or {}).get(each)) for each in chosen}
    return [_drawn(name, *picture, cameras) for name, picture in by_eye.items()]


def _drawn(eye: str, colour: Any, depth: Any, camera: Any, cameras: Mapping[str, EyeCamera]) -> DrawnPicture:
    if eye not in cameras:
        raise BadInputError(f"the {eye} eye has no camera in this frame; name its viewpoint in begin_frame.")
    if camera is None:
        return DrawnPicture(cameras[eye], colour, depth)
    if not isinstance(camera, EyeCamera):
        raise BadInputError(
            f"camera is {shown(camera)}; give what begin_frame, locate_views or EyeCamera.inset returned."
        )
    if camera.eye != eye:
        raise BadInputError(f"the camera is of the {camera.eye} eye, and the picture of the {eye} eye; name that eye.")
    return DrawnPicture(camera, colour, depth)
