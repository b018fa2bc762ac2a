"""Formats with a position in the source picture, or a ray, for each pixel of the panel."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from wlr_render.exports.export_view import ExportedView, has_ray
from wlr_render.exports.facts import facts, header_texts
from wlr_render.exports.format import Capabilities, Format
from wlr_render.io.atomic_files import write_arrays, write_image
from wlr_render.io.toml_files import write_json
from wlr_render.scene.exr_file import write_exr
from wlr_render.scene.image_files import write_map

STMAP_NO_RAY = np.float32(-1.0)
"""Position of panel pixels without a ray: outside the picture, because NaN would spread in a reader's filter."""
FFMPEG_NO_RAY = 65535
"""Position of such pixels in the remap pair: ffmpeg fills positions outside the source."""
_IN_HEADER = (
    "The header has the headset, eye, viewpoint and source camera in all digits, as texts whose names begin with wlr: "
    "(wlr:source_camera is JSON)."
)


class StMap(Format):
    """The format `stmap`: normalised positions in OpenEXR, as Nuke, Fusion, Resolve and After Effects read them."""

    name = "stmap"
    title = "STMap (OpenEXR) for compositing programs"
    holds = Capabilities(is_exr=True)
    endings = ("-stmap.exr",)
    convention = (
        "R is the position in the source picture from its left border, 0, to its right border, 1.",
        "G is the position from its bottom border, 0, to its top border, 1; B is 0.",
        "Values are sampled at the centres of the panel's pixels; the first row of the file is the panel's top row.",
        "R = G = -1 where a panel pixel has no ray: show black there.",
        _IN_HEADER,
    )
    use = (
        "Draw the source picture with the camera of the table below, and show the warped picture on the panel pixel by "
        "pixel.",
        "With a map for each colour: warp the source picture three times, with NAME-red-stmap.exr, NAME-green-stmap.exr"
        " and NAME-blue-stmap.exr, and take red from the first result, green from the second and blue from the third.",
        "OpenImageIO: `oiiotool source.exr NAME-stmap.exr --st_warp:filter=triangle:flip_t=1 --crop WxH+0+0 "
        "--fullpixels -o panel.exr`, for its t runs down and its result has the size of the source.",
        "OpenImageIO in Python: `ImageBufAlgo.st_warp(source, map, 'triangle', flip_t=True, roi=the_panels_pixels)`, "
        "which also serves a source picture smaller than the panel.",
        "Nuke: read the file as raw data, connect it to the stmap input of an STMap node, uv channels rgb, filter "
        "bilinear or better. The file was tried with OpenImageIO, not with Nuke, Fusion, Resolve or After Effects, "
        "whose convention it has: compare the check pictures below first.",
    )

    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterator[Path]:
        (width, height), source = view.source.camera.size_px, view.source_px(colour)
        channels = {"R": source[..., 0] / width, "G": 1 - source[..., 1] / height}
        channels = {name: np.where(has_ray(source), values, STMAP_NO_RAY) for name, values in channels.items()}
        channels["B"] = np.zeros_like(channels["R"])
        yield write_exr(paths[0], channels, header_texts(facts(view, colour, self)))


class FloatMap(Format):
    """The formats `pfm` and `tiff`: positions in pixels, the warp maps that `render --maps` writes."""

    holds = Capabilities()

    def __init__(self, name: Literal["pfm", "tiff"]) -> None:
        self.name = name
        self.title = f"positions in pixels ({name.upper()}) for OpenCV and others"
        self.endings = (f"-map.{name}", "-map.json")
        rows = "the bottom row first, as PFM has it" if name == "pfm" else "the top row first"
        self.convention = (
            "Three channels of float32: R is the position u in the source picture in pixels to the right, G is v in "
            "pixels downwards, B is 1 / depth in 1/m, 0 for infinity.",
            "(0, 0) is the outer corner of the picture's top left pixel, and pixel centres lie at +0.5.",
            f"Values are sampled at the centres of the panel's pixels; the file has {rows}.",
            "All three are NaN where a panel pixel has no ray: show black there.",
            "The .json file of the same name has the headset, eye, viewpoint and source camera in all digits.",
        )
        self.use = (
            f"OpenCV: `m = cv2.imread('NAME-map.{name}', cv2.IMREAD_UNCHANGED)` reads it as B, G, R with the top row "
            "first, whatever the format; `cv2.remap(light, m[..., 2] - 0.5, m[..., 1] - 0.5, cv2.INTER_LINEAR)` draws "
            "the panel's picture.",
            "`light` is the source picture in linear light as float32: decode its sRGB codes before cv2.remap, and "
            "encode the result; between codes that differ much, a mean of codes is too dark.",
            "With a map for each colour: remap three times, and take red from the result of the red map, green from "
            "the green map's and blue from the blue map's.",
            "Write 0 in place of NaN before cv2.remap, and black there afterwards.",
            "Others: read three floats per pixel without any colour management.",
        )

    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterator[Path]:
        source = view.source_px(colour)
        inverse_depth = np.full_like(source[..., :1], 1 / view.depth_m)
        values = np.concatenate([source, inverse_depth], axis=-1)
        values[~has_ray(source)] = np.nan
        map_path, facts_path = paths
        yield write_map(map_path, values)
        yield write_json(facts_path, facts(view, colour, self))


class Ffmpeg(Format):
    """The format `ffmpeg`: a pair of pictures for ffmpeg's filter remap, in whole pixels of the source."""

    name = "ffmpeg"
    title = "remap pair (16-bit PGM) for ffmpeg"
    holds = Capabilities(between_pixels=False)
    endings = ("-x.pgm", "-y.pgm", "-remap.json")
    convention = (
        "NAME-x.pgm has the column and NAME-y.pgm the row of the source pixel that a panel pixel shows; column 0 is on "
        "the left, row 0 on top.",
        "The pixel is the one that holds the position of the panel pixel's centre: nothing is interpolated.",
        f"Both are {FFMPEG_NO_RAY} where a panel pixel has no ray or one outside the picture: ffmpeg fills it.",
        "NAME-remap.json has the headset, eye, viewpoint and source camera in all digits.",
    )
    use = (
        "Draw the source picture or video with the camera of the table below, at exactly its size.",
        "`ffmpeg -i source.png -i NAME-x.pgm -i NAME-y.pgm -lavfi remap=fill=black panel.png`",
        "With a map for each colour: `ffmpeg -i source.png -i NAME-red-x.pgm -i NAME-red-y.pgm -i NAME-green-x.pgm -i "
        "NAME-green-y.pgm -i NAME-blue-x.pgm -i NAME-blue-y.pgm -filter_complex "
        '"[0]format=gbrp,extractplanes=r+g+b[r][g][b];[r][1][2]remap[R];[g][3][4]remap[G];'
        '[b][5][6]remap[B];[G][B][R]mergeplanes=0x001020:gbrp" panel.png`',
        "Videos with subsampled colours: add format=gbrp or format=yuv444p before remap.",
    )

    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterator[Path]:
        source = np.floor(view.source_px(colour))
        is_inside = view.source.camera.contains(source + np.float32(0.5))[..., None]
        column_row = np.where(is_inside, source, FFMPEG_NO_RAY).astype(np.uint16)
        *pair, facts_path = paths
        for axis, path in enumerate(pair):
            yield write_image(path, np.ascontiguousarray(column_row[..., axis]))
        yield write_json(facts_path, facts(view, colour, self))


_RAY_CONVENTION = (
    "A ray is (a, b, c, d) in the frame of the source camera: at depth Z it is at x = a Z + c, y = b Z + d, z = -Z, in "
    "metres.",
    "If Z is known, this panel pixel shows the source picture at the tangents a + c / Z, b + d / Z; "
    "(a, b) at infinity.",
    "Values are sampled at the centres of the panel's pixels, NaN where a pixel has no ray.",
)


class Rays(Format):
    """The format `rays`: the rays of all panel pixels in OpenEXR pictures of four channels, valid at every depth."""

    name = "rays"
    title = "rays of all panel pixels (OpenEXR)"
    holds = Capabilities(every_depth=True, is_exr=True)
    endings = ("-rays.exr",)
    convention = (
        "The channels R, G, B, A hold the numbers a, b, c, d of the ray of each panel pixel; A is not an opacity.",
        *_RAY_CONVENTION,
        "The first row of the file is the panel's top row.",
        _IN_HEADER,
    )
    use = (
        "As primary rays: origin (c, d, 0) and direction (a, b, -1), turned by device_from_camera and moved to the "
        "source camera's place.",
        "As a warp with depth: find the Z where the ray meets the source picture's depth, then read the picture there.",
        "With a file for each colour: each is for its own channel of the picture.",
        "Read the file as raw data. Programs that know alpha must not divide by it (Blender: alpha mode channel "
        "packed).",
    )

    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterator[Path]:
        channels = dict(zip("RGBA", view.slope_offset(colour), strict=True))
        yield write_exr(paths[0], channels, header_texts(facts(view, colour, self)))


class Npz(Format):
    """The format `npz`: the rays of all panel pixels as NumPy arrays, all colours of a view in one file."""

    name = "npz"
    title = "rays of all panel pixels (NumPy)"
    holds = Capabilities(every_depth=True)
    endings = ("-rays.npz",)
    has_all_colours = True
    convention = (
        "rays: (colours, 4, height, width) float32, the numbers a, b, c, d of the ray of each panel pixel, the top row "
        "first.",
        "colours: the names of the colours, or all for one map.",
        "facts: JSON text with the headset, eye, viewpoint, source camera and these sentences.",
        *_RAY_CONVENTION,
    )
    use = (
        "`with numpy.load('NAME-rays.npz') as data: rays, facts = data['rays'], json.loads(str(data['facts']))`",
        "`camera = facts['source_camera']` has size_px, the tangents of the borders, position_in_device_m and "
        "device_from_camera.",
        "Nothing in the file needs allow_pickle.",
    )

    def _write(self, view: ExportedView, colour: str, paths: Sequence[Path]) -> Iterator[Path]:
        rays = np.stack([view.slope_offset(each) for each in view.colours])
        text = json.dumps(facts(view, colour, self))
        yield write_arrays(paths[0], {"rays": rays, "colours": np.array(view.colours), "facts": np.array(text)})
