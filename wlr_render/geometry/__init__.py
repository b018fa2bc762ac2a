"""Frames, directions and rays: transforms, unit directions and their tangents, pinhole cameras.

Poses are `b_from_a` matrices (4, 4). Directions are unit vectors (..., 3), and tangents (x / -z, y / -z) are (..., 2).
"""

from wlr_render.lazy_names import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:  # imports in the order of the API reference
    # isort: off
    from wlr_render.geometry import transforms as transforms
    from wlr_render.geometry.directions import arcmin_between as arcmin_between, dir_of_tangents as dir_of_tangents
    from wlr_render.geometry.directions import normalised as normalised, tangents_of_dir as tangents_of_dir
    from wlr_render.geometry.pinhole import Pinhole as Pinhole
else:
    __getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
