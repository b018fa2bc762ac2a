"""Published sets of photographs of boards: folders, boards, and the authors' results."""

from dataclasses import dataclass
from pathlib import Path

from wlr_render.captures.boards.charuco import CharucoBoard
from wlr_render.captures.boards.chessboard import Chessboard
from wlr_render.captures.photographs import photographs_in


@dataclass(frozen=True)
class PhotographSet:
    """Photographs of one board by one camera.

    Attributes:
        name: folder of the set.
        part: start of the names, or subfolder, of this camera's photographs; empty for all.
        board: board as stated by the authors, unless noted otherwise.
        lens: "brown" (five terms), "rational", or "" where neither can describe the field.
        published_fx: the authors' focal length in pixels; None if not stated.
    """

    name: str
    part: str
    board: CharucoBoard | Chessboard
    lens: str
    published_fx: float | None = None

    @property
    def title(self) -> str:
        """Name of folder and part."""
        return f"{self.name} {self.part}".strip()

    def photographs(self, root: Path) -> list[Path]:
        """Return the photographs of this camera, given the folder of all sets."""
        folder = root / self.name
        if self.part and (folder / self.part).is_dir():
            return photographs_in(folder / self.part)
        return [path for path in photographs_in(folder) if path.name.startswith(self.part)]


_MONITOR = CharucoBoard(8, 8, 0.0254, 0.01905, "DICT_4X4_1000")
_MONITOR_LEGACY = CharucoBoard(8, 8, 0.0254, 0.01905, "DICT_4X4_1000", legacy=True)
_FEIRAN = CharucoBoard(25, 18, 0.0075, 0.0056, "DICT_5X5_1000", legacy=True)
_BOOFCV = Chessboard(4, 6, 0.03, 0.0)
_SOURISHG = Chessboard(9, 6, 0.02423, 0.0)

SETS = (
    PhotographSet("photonvision-charuco-1280", "", _MONITOR, "brown"),
    PhotographSet("photonvision-charuco-480", "", _MONITOR, "brown"),
    PhotographSet("photonvision-charuco-legacy-1280", "", _MONITOR_LEGACY, "brown"),
    PhotographSet("photonvision-charuco-legacy-480", "", _MONITOR_LEGACY, "brown"),
    PhotographSet("feiran-charuco-stereo", "left", _FEIRAN, "brown"),
    PhotographSet("feiran-charuco-stereo", "right", _FEIRAN, "brown"),
    PhotographSet("sourishg-fisheye-stereo-chessboard", "left", _SOURISHG, "rational"),
    PhotographSet("sourishg-fisheye-stereo-chessboard", "right", _SOURISHG, "rational"),
    PhotographSet("boofcv-bumblebee2-stereo-chessboard", "left", _BOOFCV, "brown", 524.61),
    PhotographSet("boofcv-bumblebee2-stereo-chessboard", "right", _BOOFCV, "brown", 526.44),
    PhotographSet("boofcv-sony-chessboard", "", _BOOFCV, "brown", 701.0),
    PhotographSet("boofcv-fisheye-chessboard", "", _BOOFCV, ""),
    # The authors count squares between the outermost inner corners: 5 x 7 squares are 6 x 8 inner corners.
    PhotographSet("ocamcalib-fisheye1-chessboard", "", Chessboard(6, 8, 0.0325, 0.0), ""),
    PhotographSet("ocamcalib-fisheye2-chessboard", "", Chessboard(6, 8, 0.117, 0.0), ""),
)
