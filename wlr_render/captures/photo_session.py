"""Photographic session: the content, position and camera of each photograph.

Device frame (OpenXR), metres; cameras have OpenCV's axes. Photographs are named by their place, not held: a session may
have thousands. The lists are in the order of taking.
"""

from dataclasses import dataclass
from pathlib import Path

from wlr_render.captures.boards.board import Board
from wlr_render.captures.decoded import DecodeOptions
from wlr_render.captures.patterns.pattern import Pattern
from wlr_render.geometry.lens_camera import LensCamera
from wlr_render.mappings import EyeBox
from wlr_render.numerics.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class SessionCamera:
    """A camera of the session.

    Attributes:
        size_px: width and height of its photographs.
        bits: by so many bits its largest value is reached: 8, 10, 12, 16.
        intrinsics: photographs of the board from many sides, without the headset, to calibrate it from.
        known: the camera where it is calibrated already, else None.
    """

    size_px: tuple[int, int]
    bits: int
    intrinsics: tuple[Path, ...] = ()
    known: LensCamera | None = None

    @property
    def full_scale(self) -> int:
        """Largest value that it gives."""
        return int(2**self.bits) - 1


@dataclass(frozen=True, eq=False)
class BoardPhotograph:
    """A photograph of the board, the target.

    Attributes:
        folder: of the session.
        name: path from there, by which reports name the photograph.
        target_pose: index of the target's position.
        stage: (3,) stage reading, metres; zero for the tracking camera, which is not on the stage.
    """

    folder: Path
    name: str
    target_pose: int
    stage: FloatArray

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.folder / self.name


@dataclass(frozen=True, eq=False)
class CodeSet:
    """Photographs of a pattern on the panel from one camera position.

    Attributes:
        folder: that holds them, in the order of showing by their names.
        stage: (3,) the stage's reading.
    """

    folder: Path
    stage: FloatArray


@dataclass(frozen=True, eq=False)
class PhotoSession:
    """A session as session.toml describes it.

    Attributes:
        folder: that holds session.toml; photographs are named in reports from there.
        device: the headset's name.
        eye: "left" or "right".
        eye_box: where the pupil may be, device frame.
        pattern: what the panel showed.
        decoding: when a decoded pixel is believed.
        board: the printed target.
        eyeball_camera: the camera in the place of the eye.
        tracking_camera: the headset's own camera.
        device_from_tracking: (4, 4) where that camera sits.
        bare: of the target, by the eyeball camera, without the headset.
        tracking: of the target, by the tracking camera.
        see_through: of the target, by the eyeball camera, through the optics.
        display: of the panel, by the eyeball camera.
    """

    folder: Path
    device: str
    eye: str
    eye_box: EyeBox
    pattern: Pattern
    decoding: DecodeOptions
    board: Board
    eyeball_camera: SessionCamera
    tracking_camera: SessionCamera
    device_from_tracking: FloatArray
    bare: tuple[BoardPhotograph, ...]
    tracking: tuple[BoardPhotograph, ...]
    see_through: tuple[BoardPhotograph, ...]
    display: tuple[CodeSet, ...]

    def name_of(self, path: Path) -> str:
        """A photograph's or folder's name as reports give it."""
        return str(path.relative_to(self.folder)) if path.is_relative_to(self.folder) else str(path)
