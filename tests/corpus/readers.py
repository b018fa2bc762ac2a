"""The readers of the valid files, as functions of a path."""

from collections.abc import Callable
from pathlib import Path

from wlr_render.bench.session_folder import load_session
from wlr_render.calibration.bench.station_file import read_lens, read_station
from wlr_render.captures.boards.board_file import load_board
from wlr_render.captures.camera_lens_file import load_lens
from wlr_render.captures.capture_file import load_observations
from wlr_render.captures.photo_session_file import load_photo_session
from wlr_render.captures.photographs import read_photograph
from wlr_render.io.toml_files import Table
from wlr_render.models.model_file import load_eye_models
from wlr_render.optics.device_file import device_content, device_of, load_device
from wlr_render.optics.lens_files.glass_catalogues import GlassCatalogue
from wlr_render.optics.lens_files.headset_of_lens import HeadsetChoices, headset_of_lens
from wlr_render.optics.lens_files.lens_file import read_lens_file
from wlr_render.report.comparison import read_report
from wlr_render.scene.scene_file import load_scene
from wlr_render.tracking.eye_trajectory_file import read_eye_trajectory
from wlr_render.tracking.head_trajectory_file import read_head_trajectory

_CHOICES = HeadsetChoices(
    name="lens",
    source="a lens file",
    starts_at="eye",
    pupil_surface=None,
    eye_relief_mm=None,
    panel_surface=None,
    panel_mm=(10.0, 8.0),
    panel=(64, 48),
    eye_box_mm=(8.0, 6.0, 4.0),
    eye_centre_mm=(0.0, 0.0, 0.0),
    eye="right",
    semi_diameters=True,
)


def _read_recording(path: Path) -> object:
    return read_head_trajectory(path), read_eye_trajectory(path)


def _read_optics(path: Path) -> object:
    _, lens = read_lens_file(path, GlassCatalogue((path.with_name("glasses.agf"),)))
    device = headset_of_lens(path, lens, _CHOICES).device
    return device_of(Table(device_content(device), str(path)))


READERS: dict[str, Callable[[Path], object]] = {
    "device.toml": load_device,
    "prism5701202.toml": load_device,
    "birdbath28.toml": load_device,
    "freeform40.toml": load_device,
    "scene.toml": load_scene,
    "box.obj": load_scene,
    "box.ply": load_scene,
    "binary.ply": load_scene,
    "box.stl": load_scene,
    "ascii.stl": load_scene,
    "textured.glb": load_scene,
    "gltf/box.gltf": load_scene,
    "model.json": load_eye_models,
    "captures.npz": load_observations,
    "head.txt": read_head_trajectory,
    "head.csv": read_head_trajectory,
    "eyes.txt": read_eye_trajectory,
    "gaze.txt": read_eye_trajectory,
    "recording.jsonl": _read_recording,
    "bench/bench.toml": lambda path: load_session(path.parent),
    "bench/display.csv.gz": lambda path: load_session(path.parent),
    "photos/session.toml": lambda path: load_photo_session(path.parent),
    "board.toml": load_board,
    "calibration/station-right.json": lambda path: read_lens(read_station(path).table("eyeball_camera")),
    "lens.yaml": load_lens,
    "lens_ros.yaml": load_lens,
    "camchain.yaml": load_lens,
    "target.yaml": load_board,
    "lens.xml": load_lens,
    "lens.cameramodel": load_lens,
    "codes/03.png": read_photograph,
    "photos/bare.png": read_photograph,
    "lens.zmx": _read_optics,
    "lens.seq": _read_optics,
    "optiland.json": _read_optics,
    "rayoptics.roa": _read_optics,
    "report.json": lambda path: read_report(path, "import-lens"),
    "glasses.agf": lambda path: _read_optics(path.with_name("lens.zmx")),
}
"""By the name of the file that it reads. A reader of a folder takes the folder of the file."""
