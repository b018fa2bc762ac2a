"""The pair of pictures that ffmpeg's filter remap reads: whole pixels of the source picture."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from wlr_render.exports.facts import facts, write_facts
from wlr_render.exports.format import Carries
from wlr_render.exports.view import ExportedView
from wlr_render.files import write_image

NOTHING = 65535
"""Of both pictures where a panel pixel has no ray: ffmpeg fills positions outside the source."""


class Ffmpeg:
    """The format `ffmpeg`."""

    name = "ffmpeg"
    title = "remap pair (16-bit PGM) for ffmpeg"
    carries = Carries(between_pixels=False)
    convention = (
        "NAME-x.pgm has the column and NAME-y.pgm the row of the source pixel that a panel pixel shows; column 0 is on "
        "the left, row 0 on top.",
        "The pixel is the one that holds the position of the panel pixel's centre: nothing is interpolated.",
        f"Both are {NOTHING} where a panel pixel has no ray or one beside the picture: ffmpeg fills it.",
    )
    use = (
        "Draw the source picture or video with the camera of the table below, at exactly its size.",
        "ffmpeg -i source.png -i NAME-x.pgm -i NAME-y.pgm -lavfi remap=fill=black panel.png",
        "With a map for each colour: ffmpeg -i source.png -i NAME-red-x.pgm -i NAME-red-y.pgm, then green and blue, "
        '-filter_complex "[0]format=gbrp,extractplanes=r+g+b[r][g][b];[r][1][2]remap[R];[g][3][4]remap[G];'
        '[b][5][6]remap[B];[G][B][R]mergeplanes=0x001020:gbrp" panel.png',
        "Videos with subsampled colours: add format=gbrp or format=yuv444p before remap.",
    )

    def files(self, view: ExportedView) -> list[str]:
        """Two pictures and their facts for each colour."""
        return view.file_names("-x.pgm", "-y.pgm", "-remap.json")

    def write(self, views: Iterable[ExportedView], folder: Path) -> Iterator[Path]:
        """Write two files for each view and colour, and their facts as .json."""
        for view in views:
            paths = iter([folder / name for name in self.files(view)])
            for colour in view.colours:
                source = np.floor(view.source_px(colour))
                is_inside = view.source.camera.contains(source + np.float32(0.5))[..., None]
                column_row = np.where(is_inside, source, NOTHING).astype(np.uint16)
                for axis in (0, 1):
                    yield write_image(next(paths), np.ascontiguousarray(column_row[..., axis]))
                yield write_facts(next(paths), facts(view, colour, self))
