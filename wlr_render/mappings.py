"""The two protocols that all models implement, and the result of every query.

Exact optics, planar models and all baselines implement `DisplayMapping` and `SeeThroughMapping`; rendering, evaluation
and diagnosis do not know which one they use. All arrays are in the device frame (OpenXR: x right, y up, looking
along -z), metres, and have any leading axes; `pixel`, `viewpoint`, `view_dir` and `point` broadcast against
each other.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import dir_of_tangents, tangents_of_dir
from wlr_render.geometry.planes import BasePlane
from wlr_render.html_summary import SummaryTable, html_summary
from wlr_render.io.file_records import Key
from wlr_render.numerics.arrays import FloatArray
from wlr_render.numerics.polynomial import Polynomial

StatusArray = NDArray[np.uint8]

EYE_BOX_MARGIN = 0.5e-3
"""Distance from the eye box (metres) up to which a viewpoint counts as inside: about the error of eye tracking."""


class Status(IntEnum):
    """Outcome of a query; only OK and OUTSIDE_FIT have a value, all others have NaN."""

    OK = 0
    OUTSIDE_FIT = 1
    """The query lies outside the box that the model was fitted on; its value is an extrapolation."""
    NOT_CONVERGED = 2
    """The solve did not converge."""
    MISS = 3
    """The ray misses a surface."""
    CLIPPED = 4
    """The ray falls outside a clear aperture or the panel."""
    TOTAL_REFLECTION = 5
    """The ray is totally reflected where it should be refracted."""


def worst_status(*statuses: StatusArray) -> StatusArray:
    """Return the element-wise worst of several broadcastable status arrays; the enumeration is ordered by severity."""
    result = np.asarray(statuses[0], dtype=np.uint8)
    for status in statuses[1:]:
        result = np.maximum(result, status)
    return result


def count_unsolved(statuses: Iterable[StatusArray]) -> dict[str, int]:
    """Count each status except OK in some status arrays, by name: {"not converged": 12}."""
    counts = np.zeros(len(Status), dtype=np.int64)
    for status in statuses:
        counts += np.bincount(status.reshape(-1), minlength=len(Status))
    return {each.name.lower().replace("_", " "): int(counts[each]) for each in Status if each and counts[each]}


@dataclass(frozen=True, eq=False)
class QueryResult:
    """Answer to a batched query.

    Attributes:
        value: (..., k) float64; NaN where the status is neither OK nor OUTSIDE_FIT.
        status: (...) uint8, one `Status` each.
        warm_start: `warm_start` for the next query of the same shape; None for closed forms.
    """

    value: FloatArray
    status: StatusArray
    warm_start: FloatArray | None = None

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Mask of the elements with a value inside the fit, (...) bool."""
        return np.asarray(self.status == Status.OK)

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Mask of the elements with a value, inside the fit or extrapolated, (...) bool."""
        return np.asarray(self.status <= Status.OUTSIDE_FIT)


@dataclass(frozen=True)
class Panel:
    """The pixels of a display panel: (0, 0) is the outer corner of the top-left pixel, u runs right, v down."""

    width_px: Annotated[int, Key(least=1)]
    height_px: Annotated[int, Key(least=1)]

    @property
    def size_px(self) -> FloatArray:
        """(2,): width, height."""
        return np.array([self.width_px, self.height_px], dtype=np.float64)

    def contains(self, pixel: FloatArray, margin: float = 1e-6) -> NDArray[np.bool_]:
        """Return whether pixels (..., 2) lie on the panel (grown by `margin` pixels against rounding), (...) bool."""
        return np.asarray(np.all((pixel >= -margin) & (pixel <= self.size_px + margin), axis=-1))

    def pixel_centres(self) -> FloatArray:
        """Return the centres of all pixels, shape (height, width, 2)."""
        u, v = np.meshgrid(np.arange(self.width_px) + 0.5, np.arange(self.height_px) + 0.5)
        return np.stack([u, v], axis=-1)

    def grid(self, columns: int, rows: int) -> FloatArray:
        """Return a coarse grid of pixel positions, cell-centred over the panel, shape (rows, columns, 2)."""
        u = (np.arange(columns) + 0.5) / columns * self.width_px
        v = (np.arange(rows) + 0.5) / rows * self.height_px
        return np.stack(np.meshgrid(u, v), axis=-1)


@dataclass(frozen=True, eq=False)
class EyeBox:
    """Box of valid viewpoints, axis-aligned in the device frame.

    Attributes:
        centre: (3,) metres, the nominal viewpoint.
        size: (3,) metres, full edge lengths.
    """

    centre: Annotated[FloatArray, Key("centre_m", shape=(3,))]
    size: Annotated[FloatArray, Key("size_m", shape=(3,))]

    def contains(self, viewpoint: FloatArray, margin: float = 1e-9) -> NDArray[np.bool_]:
        """Return whether viewpoints (..., 3) lie in the box (grown by `margin` metres), (...) bool."""
        inside = np.abs(viewpoint - self.centre) <= 0.5 * self.size + margin
        return np.asarray(np.all(inside, axis=-1))

    def at(self, unit: FloatArray) -> FloatArray:
        """Return the points at box coordinates -1..1, (..., 3) -> (..., 3)."""
        return self.centre + 0.5 * self.size * np.asarray(unit)


@dataclass(frozen=True, eq=False)
class FieldOfView:
    """A box of directions.

    Attributes:
        low, high: (2,) tangents (tx, ty).
    """

    low: FloatArray
    high: FloatArray

    @property
    def reach(self) -> FloatArray:
        """(2,) largest |tx| and |ty|."""
        return np.maximum(np.abs(self.low), np.abs(self.high))

    def __str__(self) -> str:
        (left, down), (right, up) = np.rad2deg(np.arctan([self.low, self.high]))
        return f"{left:g} to {right:+g} x {down:g} to {up:+g} degrees"

    def contains(self, view_dir: FloatArray) -> NDArray[np.bool_]:
        """Return whether directions (..., 3) lie in the field of view, (...) bool."""
        tangents = tangents_of_dir(view_dir)
        return np.asarray(np.all((tangents >= self.low) & (tangents <= self.high), axis=-1))

    def directions(self, columns: int, rows: int) -> FloatArray:
        """Return a grid of unit directions from edge to edge, evenly spaced in tangents, (rows * columns, 3)."""
        tx, ty = (np.linspace(self.low[axis], self.high[axis], n) for axis, n in enumerate((columns, rows)))
        return dir_of_tangents(np.stack(np.meshgrid(tx, ty), axis=-1).reshape(-1, 2))


class DisplayMapping(Protocol):
    """Protocol of the display mapping: the panel as the eye sees it (paper: f_display)."""

    @property
    def panel(self) -> Panel:
        """The panel whose pixels are mapped."""

    def view_dir_of_pixel(
        self, pixel: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the forward query: the view direction of a pixel.

        Args:
            pixel: (..., 2) panel pixels.
            viewpoint: (..., 3) device frame, metres.
            warm_start: `QueryResult.warm_start` of an earlier query of the same shape.

        Returns:
            `value` (..., 3): unit `view_dir`, from the viewpoint outwards.
        """

    def pixel_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the backward query: the pixel in a view direction; `value` (..., 2)."""


class SeeThroughMapping(Protocol):
    """Protocol of the see-through mapping: the world through the combiner (paper: f_seethru)."""

    def real_ray_of_view_dir(
        self, view_dir: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the forward query: the world ray behind the optics of a view direction.

        Returns:
            `value` (..., 6): a point of the ray (metres), then its unit direction, away from the eye. The point
            lies on the ray's line, not necessarily beyond the optics: see `geometry.rays.split`.
        """

    def view_dir_of_real_point(
        self, point: FloatArray, viewpoint: FloatArray, warm_start: FloatArray | None = None
    ) -> QueryResult:
        """Answer the backward query: the view direction of a real point (..., 3); `value` (..., 3) unit `view_dir`."""


@dataclass(frozen=True, eq=False)
class Eye:
    """One eye of a headset: the mappings of its display and of the world, its eye box and nominal field of view.

    `open_eye` gives one with exact optics or fitted models, `calibrate` a fitted one. All queries take arrays with any
    leading axes, in the device frame, and give a `value` and the `Status` of each element.

    Attributes:
        name: device name, and how the mappings were made, e.g. "northstar (planar N=5)".
        eye: "left" or "right".
        display: the panel's mapping.
        see_through: the world's mapping.
        eye_box: box of valid viewpoints; its centre is the nominal viewpoint.
        field: the nominal field of view, over which errors are stated; None for the whole panel.

    Example:
        >>> import numpy as np, wlr_render as wlr
        >>> eye = wlr.open_eye("northstar", "right")
        >>> view_dir = eye.display.view_dir_of_pixel(np.array([720.0, 800.0]), eye.eye_box.centre).value
        >>> world_ray = eye.see_through.real_ray_of_view_dir(view_dir, eye.eye_box.centre).value  # point, direction
    """

    name: str
    eye: str
    display: DisplayMapping
    see_through: SeeThroughMapping
    eye_box: EyeBox
    field: FieldOfView | None = None

    @property
    def summary(self) -> SummaryTable:
        """Summary for notebooks."""
        try:
            panel = f"{self.display.panel.width_px} x {self.display.panel.height_px} px"
        except BadInputError:
            panel = "not calibrated"
        size, centre = ([f"{1e3 * each:.3g}" for each in of] for of in (self.eye_box.size, self.eye_box.centre))
        rows = [
            ("panel", panel),
            ("eye box, width x height x depth", f"{' x '.join(size)} mm"),
            ("centre of the eye box, x, y, z in the device frame", f"{', '.join(centre)} mm"),
            ("nominal field of view", "not stated" if self.field is None else str(self.field)),
        ]
        return SummaryTable([], rows)

    def __repr__(self) -> str:
        return f"Eye({self.name!r}, {self.eye!r})"

    def _repr_html_(self) -> str:
        return html_summary(f"{self.name}, {self.eye} eye", [], [self.summary])


EyeChannels = tuple[Eye, ...]
"""One pair of mappings for all colours of an eye, or three for red, green and blue."""
COLOURS = ("red", "green", "blue")
_OfChannel = TypeVar("_OfChannel")


def middle_channel(channels: Sequence[_OfChannel]) -> _OfChannel:
    """Return the green channel of an eye, or its only one."""
    return channels[len(channels) // 2]


class PlanarModel(Protocol):
    """Protocol of mappings that a shader can solve: a polynomial of the point p~ = place.carry(viewpoint, t).

    A viewpoint sees a pixel of a display at tangents t(pixel, p~). Beyond the optics, the ray of tangents t passes
    through (p~ + B, z of the plane at p~) with tangents t + A: B is an offset at constant z, also on a tilted plane.
    """

    @property
    def eye_box(self) -> EyeBox:
        """Eye box; a viewpoint more than `EYE_BOX_MARGIN` outside it is OUTSIDE_FIT."""

    @property
    def place(self) -> BasePlane:
        """Base plane of p~; the eye's other mapping may have a different one."""

    @property
    def modelled(self) -> Polynomial:
        """Polynomial (u px, v px, x m, y m) -> (tx, ty), or (x m, y m, tx, ty) -> (Ax, Ay, Bx m, By m)."""


def is_planar(mappings: Eye) -> bool:
    """Return whether both mappings of an eye are planar models of polynomials."""
    return all(
        isinstance(getattr(side, "place", None), BasePlane) and isinstance(getattr(side, "modelled", None), Polynomial)
        for side in (mappings.display, mappings.see_through)
    )


def require_planar(mappings: Eye) -> tuple[PlanarModel, PlanarModel]:
    """Return the planar display and see-through models of an eye.

    Raises:
        BadInputError: the mappings are not planar models.
    """
    if not is_planar(mappings):
        raise BadInputError(
            f"{mappings.name}: only planar models can be solved in a shader; use the node grid, or fit a planar model."
        )
    display: Any = mappings.display
    see_through: Any = mappings.see_through
    return display, see_through
