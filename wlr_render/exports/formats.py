"""The formats of `export`, by name."""

from typing import Literal

from wlr_render.exports.c_model import CModel
from wlr_render.exports.format import Format
from wlr_render.exports.mesh import GltfMesh
from wlr_render.exports.monado import Monado
from wlr_render.exports.mrcal import Mrcal
from wlr_render.exports.page import Page
from wlr_render.exports.pixel_maps import Ffmpeg, FloatMap, Npz, Rays, StMap
from wlr_render.exports.steamvr import SteamVr

FormatName = Literal["stmap", "rays", "pfm", "tiff", "ffmpeg", "npz", "mesh", "monado", "mrcal", "steamvr", "c", "page"]
_FLOAT_MAPS = FloatMap("pfm"), FloatMap("tiff")
_FILES_OF_MODELS = CModel(), Page()
FORMATS: tuple[Format, ...] = (
    *(StMap(), Rays(), *_FLOAT_MAPS, Ffmpeg(), Npz(), GltfMesh(), Monado(), Mrcal(), SteamVr()),
    *_FILES_OF_MODELS,
)


def format_of(name: str) -> Format:
    """Return the format with a name."""
    return next(form for form in FORMATS if form.name == name)
