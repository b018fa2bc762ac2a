"""The bench of a calibration, from its station-EYE.json: device frame (OpenXR), metres."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.calibration.bench.board_shape import BoardShape
from wlr_render.calibration.bench.state import StageModel
from wlr_render.calibration.bench.station_file import read_lens, read_station
from wlr_render.errors import BadInputError
from wlr_render.io.toml_files import Table
from wlr_render.lenses.lens import Lens
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.smooth_field import SmoothField


@dataclass(frozen=True, eq=False)
class SavedStation:
    """Contents of station-EYE.json.

    Attributes:
        eyeball_camera, tracking_camera: lenses of the cameras; None without a tracking camera.
        device_from_tracking: (4, 4), or None.
        base: (4, 4) device_from_camera at the middle of the stage's readings; None without a stage.
        stage: motion of the camera by the stage, or None.
        shape: shape of the board, or None.
    """

    eyeball_camera: Lens
    tracking_camera: Lens | None
    device_from_tracking: FloatArray | None
    base: FloatArray | None
    stage: StageModel | None
    shape: BoardShape | None

    def device_from_camera(self, reading: FloatArray) -> FloatArray:
        """Return the camera pose (4, 4) at a stage reading (m,).

        Raises:
            BadInputError: the bench has no stage.
        """
        if self.base is None or self.stage is None:
            raise BadInputError(
                "the calibrated bench has no stage, so a reading has no camera pose; calibrate with [stage]."
            )
        return np.asarray(self.base @ self.stage.motion(np.asarray(reading)))


def load_station(path: str | Path) -> SavedStation:
    """Read station-EYE.json as written by `calibrate`.

    Raises:
        BadInputError: the file is missing, or of another kind.
    """
    table, base, stage = read_station(path), None, None
    if table.has("stage"):
        part = table.table("stage")
        base = part.table("device_from_camera").vectors("matrix", 4)
        stage = StageModel(
            part.numbers("middle"),
            part.numbers("half_range"),
            part.vectors("twists", 6),
            part.vectors("smooth_error", 6),
        )
    is_tracked = table.has("tracking_camera")
    return SavedStation(
        read_lens(table.table("eyeball_camera")),
        read_lens(table.table("tracking_camera")) if is_tracked else None,
        table.vectors("device_from_tracking", 4) if is_tracked else None,
        base,
        stage,
        _shape(table.table("board")) if table.raw("board") else None,
    )


def _shape(table: Table) -> BoardShape:
    fields = None
    if table.has("heights"):
        fields = _field(table.table("heights")), _field(table.table("printing_errors"))
    return BoardShape(
        table.vector("half_size_m", 2),
        table.numbers("shape"),
        table.vectors("feature", 2).astype(np.int64),
        table.vectors("feature_error_m", 3),
        fields,
    )


def _field(table: Table) -> SmoothField:
    low, high, counts = (table.vector(key, 2) for key in ("low", "high", "counts"))
    return SmoothField((low[0], low[1]), (high[0], high[1]), (int(counts[0]), int(counts[1])))
