"""Read device prescriptions (format: devices/README.md). Converts millimetres and degrees to metres and radians."""

import difflib
import re
from collections.abc import Callable
from pathlib import Path as FilePath

import numpy as np

from wlr_render.atomic_files import named_or_path
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import normalised
from wlr_render.geometry.transforms import FRAMES, rigid, rotation_about
from wlr_render.input_files import require_eye_box, require_length, require_pixels, shown
from wlr_render.mappings import EyeBox, FieldOfView, Panel
from wlr_render.numerics.arrays import FloatArray
from wlr_render.optics.device import (
    ClearAperture,
    Device,
    EyeOptics,
    Interaction,
    Path,
    PlacedPanel,
    PlacedSurface,
    Step,
    mirrored,
)
from wlr_render.optics.glass_files import shipped_glasses
from wlr_render.optics.media import AIR, INDICES, Medium
from wlr_render.optics.raised import FormError, Raised, RaisedSag, raised
from wlr_render.optics.sag_surfaces import (
    AnamorphicAsphere,
    AnamorphicTerm,
    Asphere,
    GaussianBump,
    SagSurface,
    SumOfProfiles,
    Toroid,
    XYPolynomial,
)
from wlr_render.optics.surfaces import Conic, Ellipsoid, Offset, Shape
from wlr_render.toml_files import Table, read_toml

MM = 1e-3
"""One millimetre in metres."""

_MIRROR_Y = np.diag([1.0, -1.0, 1.0])

_ABBE_NUMBERS = 5.0, 200.0
_FAR_MM = 2000.0  # largest distance of a part of a headset from the origin
_OPEN_MM = 10.0  # least half width of a surface without an aperture
_STEEPEST_SLOPE = 20.0  # largest slope of a surface given by its sag: 87 degrees
_FLAT_MM = 1e12  # radius written for a practically flat surface
_EYE_BOX_LEAST_MM = 0.1
_PANEL_LEAST_MM = 0.5
_STEEPEST_DEG = 89.0  # largest angle of a field of view, which is described by tangents
_HIGHEST_POWER = 20  # highest total power of x and y
_MOST = 100  # most surfaces, steps of a path, media, or terms
_DEEPEST = 6  # deepest nesting of surfaces based on others: the time for a ray grows exponentially with it
_OTHER_SIDE = {"right": "left", "left": "right"}


def placed_surface(table: Table, frame: FloatArray, earlier: dict[str, PlacedSurface]) -> PlacedSurface:
    """Read one [[eye.surface]]; `frame` turns the file's axes into the device's, `earlier` surfaces may be bases."""
    name = table.text("name")
    if name in earlier:
        raise table.fail(f"there is already a surface '{name}'; choose another name.")
    kind = table.text("shape", choices=[*_SHAPES, "offset", "raised"])
    aperture = _aperture(table)
    if kind in ("offset", "raised"):
        base = earlier[named(table, "of", "earlier surface", earlier)]
        if len(base_chain(base.shape)) > _DEEPEST:
            raise table.fail(f"'of' leads through more than {_DEEPEST} surfaces; state this one by an earlier surface.")
        if kind == "offset":
            shape: Shape = Offset(base.shape, _length(table, "distance_mm"))
        else:
            errors = table.tables("error", most=_MOST)
            shape = raised(base.shape, *(_form_error(each, frame, base) for each in errors))
        placed = PlacedSurface(name, shape, base.device_from_surface, aperture)
    else:
        placed = PlacedSurface(name, _SHAPES[kind](table), _pose(table, frame), aperture)
    if isinstance(placed.shape, SagSurface):
        _require_smooth(table, placed.shape, aperture)
    table.finish()
    return placed


def _require_smooth(table: Table, shape: SagSurface, aperture: ClearAperture) -> None:
    """Refuse a sag too steep for optics within the aperture, or near the vertex along an axis that is open.

    Newton's method does not converge on it, and takes minutes to fail for every pixel.
    """
    low, high = (
        np.where(np.isinf(side), np.sign(side) * MM * _OPEN_MM, side)[:2] for side in (aperture.low, aperture.high)
    )
    x, y = np.meshgrid(*(low + (high - low) * (np.arange(8.0)[:, None] + 0.5) / 8).T)
    with np.errstate(all="ignore"):  # NaN beyond the edge of the shape
        slopes = np.abs(shape.sag_and_slopes(x.ravel(), y.ravel())[1:])
    steepest = np.nanmax(slopes, initial=0.0)
    if steepest > _STEEPEST_SLOPE:
        raise table.fail(
            f"rises {steepest:.3g} mm per mm within its aperture, more than the plausible {_STEEPEST_SLOPE:g}; are its "
            "numbers in powers of millimetres?"
        )


def _form_error(table: Table, frame: FloatArray, base: PlacedSurface) -> FormError:
    """Return one [[eye.surface.error]], a shape z(x, y) with its pose."""
    sag = _SAG_SHAPES[table.text("shape", choices=sorted(_SAG_SHAPES))](table)
    error = FormError(sag, base.surface_from_device @ _pose(table, frame))
    table.finish()
    return error


def _aperture(table: Table) -> ClearAperture:
    """Read `aperture_x_mm`, `aperture_y_mm`, `aperture_z_mm`; open along an axis that is left out."""
    keys = [f"aperture_{axis}_mm" for axis in "xyz"]
    sides = [_lengths(table, key, 2) if table.has(key) else np.array([-np.inf, np.inf]) for key in keys]
    low, high = np.stack(sides, axis=1)
    if not np.all(low < high):
        raise table.fail("each 'aperture_*_mm' must be [low, high] with low below high.")
    return ClearAperture(low, high)


def _pose(table: Table, frame: FloatArray) -> FloatArray:
    """Read `origin_mm`, the axes by `rotate_x_deg` or by the vectors `x_axis` and `z_axis`, and `mirrored`."""
    if table.has("z_axis"):
        rotation = axes(table, "z_axis", "x_axis")[:, [1, 2, 0]]
    else:
        rotation = rotation_about("x", np.deg2rad(table.number("rotate_x_deg", default=0.0)))
    if table.flag("mirrored", default=False):
        rotation = rotation @ _MIRROR_Y
    return rigid(frame @ rotation, frame @ _lengths(table, "origin_mm", 3))


def axes(table: Table, first: str, second: str) -> FloatArray:
    """Return the right-handed unit axes in columns: `first`, `second` made orthogonal to it, and their product."""
    a, b = table.vector(first, 3), table.vector(second, 3)
    lengths = np.linalg.norm(a) * np.linalg.norm(b)
    if lengths == 0 or abs(a @ b) > 1e-3 * lengths:
        raise table.fail(f"'{first}' and '{second}' must be perpendicular and not zero.")
    a = normalised(a)
    b = normalised(b - (a @ b) * a)
    return np.stack([a, b, np.cross(a, b)], axis=1)


def _ellipsoid(table: Table) -> Shape:
    semi_axes = _lengths(table, "semi_axes_mm", 3, _FLAT_MM)
    if not np.all(semi_axes > 0):
        raise table.fail("'semi_axes_mm' must be positive.")
    return Ellipsoid(semi_axes)


def _xy_polynomial(table: Table) -> XYPolynomial:
    sag = table.table("sag_mm")
    powers = {key: _powers(sag, key) for key in sag.keys()}  # noqa: SIM118 (a Table is no dictionary)
    if not powers:
        raise sag.fail("the coefficients are missing; give at least one, such as x2.")
    coefficients = np.zeros(np.max(list(powers.values()), axis=0) + 1)
    for key, (m, n) in powers.items():
        coefficients[m, n] = sag.number(key) * MM ** (1 - m - n)
    if not table.has("radius_mm"):
        return XYPolynomial(coefficients)
    base = 1.0 / _length(table, "radius_mm", _FLAT_MM)
    return XYPolynomial(coefficients, base, table.number("conic", default=0.0))


def _powers(sag: Table, key: str) -> tuple[int, int]:
    """Return the powers of x and y in a key such as "x2y" or "y3"."""
    match = re.fullmatch(r"(?:x(\d*))?(?:y(\d*))?", key)
    if not key or match is None:
        raise sag.fail(f"{shown(key)} is not a term in x and y; write x2, xy3, y4 and so on.")
    m, n = (0 if power is None else int((power or "1")[:9]) for power in match.groups())
    if m + n > _HIGHEST_POWER:
        raise sag.fail(f"{shown(key)} is of order {m + n}; {_HIGHEST_POWER} is the highest that is read.")
    return m, n


def _asphere(table: Table) -> Asphere:
    sag = table.table("sag_mm")
    powers = {key: _power_of_r(sag, key) for key in sag.keys()}  # noqa: SIM118 (a Table is no dictionary)
    if not powers:
        raise sag.fail("the coefficients are missing; give at least one, such as r4.")
    coefficients = [0.0] * (max(powers.values()) - 1)
    for key, power in powers.items():
        coefficients[power - 2] = sag.number(key) * MM ** (1 - power)
    curvature = 1.0 / _length(table, "radius_mm", _FLAT_MM) if table.has("radius_mm") else 0.0
    return Asphere(tuple(coefficients), curvature, table.number("conic", default=0.0) if curvature else 0.0)


def _power_of_r(sag: Table, key: str) -> int:
    match = re.fullmatch(r"r(\d{1,2})", key)
    if match is None or not 2 <= int(match[1]) <= _HIGHEST_POWER:
        raise sag.fail(f"{shown(key)} is not a term of an asphere; write r2, r4 and so on, up to r{_HIGHEST_POWER}.")
    return int(match[1])


def _biconic(table: Table) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the curvatures in 1/m and conics along x and y; a profile without a radius is straight."""
    keys = "radius_x_mm", "radius_y_mm"
    if not any(map(table.has, keys)):
        raise table.fail(f"neither {' nor '.join(keys)} is there; write at least one.")
    x, y = (1.0 / _length(table, key, _FLAT_MM) if table.has(key) else 0.0 for key in keys)
    return (x, y), (table.number("conic_x", default=0.0), table.number("conic_y", default=0.0))


def _anamorphic(table: Table) -> AnamorphicAsphere:
    terms = []
    for entry in table.tables("term", required=False, most=_MOST):
        order = entry.number("order")
        if order not in (4, 6, 8, 10):
            raise entry.fail(f"'order' is {order:g}; it must be 4, 6, 8 or 10.")
        amplitude = entry.number("sag_mm") * MM ** (1 - order)
        terms.append(AnamorphicTerm(amplitude, entry.number("asymmetry", default=0.0), int(order) // 2))
        entry.finish()
    return AnamorphicAsphere(*_biconic(table), tuple(terms))


_SAG_SHAPES: dict[str, Callable[[Table], SagSurface]] = {
    "toroid": lambda table: Toroid(*(_length(table, f"radius_{axis}_mm", _FLAT_MM) for axis in "xy")),
    "asphere": _asphere,
    "xy_polynomial": _xy_polynomial,
    "sum_of_profiles": lambda table: SumOfProfiles(*_biconic(table)),
    "anamorphic": _anamorphic,
    "bump": lambda table: GaussianBump(MM * table.number("height_mm"), MM * table.number("width_mm", above=0)),
}
_SHAPES: dict[str, Callable[[Table], Shape]] = {
    "plane": lambda _: Conic(0.0),
    "conic": lambda table: Conic(1.0 / _length(table, "radius_mm", _FLAT_MM), table.number("conic", default=0.0)),
    "ellipsoid": _ellipsoid,
    **_SAG_SHAPES,
}


def base_chain(shape: Shape) -> list[Shape]:
    """Return the shape itself and, if it is displaced from a base, the base, its base, and so on."""
    return [shape, *base_chain(shape.base)] if isinstance(shape, Offset | Raised | RaisedSag) else [shape]


def named(entry: Table, key: str, kind: str, choices: dict[str, PlacedSurface] | dict[str, Medium]) -> str:
    """Return a key that names something defined in the file."""
    name = entry.text(key)
    if name not in choices:
        raise entry.fail(
            f"'{key}' names the {kind} {shown(name)}, which is not defined "
            f"({', '.join(choices) or 'none is'}); correct it."
        )
    return name


def _length(table: Table, key: str, at_most_mm: float = _FAR_MM) -> float:
    """Return a length other than 0, in metres; `key` is in millimetres."""
    value = table.number(key)
    if value == 0:
        raise table.fail(f"'{key}' must not be 0.")
    require_length(f"{table.where}: '{key}'", value, at_most_mm, "mm")
    return MM * value


def _lengths(table: Table, key: str, size: int, at_most_mm: float = _FAR_MM) -> FloatArray:
    """Return (size,) lengths in metres; `key` is in millimetres."""
    values = table.vector(key, size)
    require_length(f"{table.where}: '{key}'", values, at_most_mm, "mm")
    return MM * values


def load_device(spec: str | FilePath) -> Device:
    """Read a device by its shipped name or by the path of its file.

    Raises:
        BadInputError: the file does not exist, is not TOML, or breaks the format; the sentence says where.
    """
    return device_of(read_toml(device_path(spec)))


def device_path(spec: str | FilePath) -> FilePath:
    """Return the path of a device file, given a shipped device's name or a path.

    Raises:
        BadInputError: the device does not exist, or the file holds JSON, as fitted models do.
    """
    path = named_or_path("devices", spec)
    if path.suffix.lower() == ".json":
        raise BadInputError(
            f"{path}: is a model file, or another JSON file, and a device is needed: name a shipped device or a device "
            "file (.toml). Fitted models are taken by render, export and budget."
        )
    return path


def device_of(file: Table) -> Device:
    """Build a device from an opened file; every key must be known."""
    frame = FRAMES[file.text("frame", choices=sorted(FRAMES))]
    media = _media(file)
    eyes: dict[str, EyeOptics] = {}
    for table in file.tables("eye"):
        side = table.text("side", choices=sorted(_OTHER_SIDE))
        wanted = [side, _OTHER_SIDE[side]] if table.flag("also_mirrored", default=False) else [side]
        for name in wanted:
            if name in eyes:
                raise table.fail(f"the {name} eye is already given; give each side once.")
        eye = _eye(table, frame, media)
        eyes.update(zip(wanted, [eye, mirrored(eye)], strict=False))
    if not eyes:
        raise file.fail("there is no [[eye]]; give at least one.")
    device = Device(file.file_stem("name"), file.text("source"), eyes)
    file.finish()
    return device


def _media(file: Table) -> dict[str, Medium]:
    media = {AIR.name: AIR}
    for table in file.tables("medium", required=False, most=_MOST):
        name = table.text("name")
        if name in media:
            raise table.fail(f"there is already a medium '{name}'; choose another name.")
        media[name] = _medium(table, name)
        table.finish()
    return media


def _medium(table: Table, name: str) -> Medium:
    given = [key for key in _MEDIA if table.has(key)]
    readers = {_MEDIA[key] for key in given}
    if len(readers) != 1:
        raise table.fail(f"give the index by one of {', '.join(_MEDIA)}; {' and '.join(given) or 'none'} is there.")
    medium = readers.pop()(table, name).shifted(table.number("index_shift", default=0.0))
    if fault := medium.fault():
        raise table.fail(fault)
    return medium


def _named_glass(table: Table, name: str) -> Medium:
    formula = table.text("formula")
    glasses = shipped_glasses()
    if formula not in glasses:
        like = difflib.get_close_matches(formula.upper(), glasses, 3, 0.0)
        raise table.fail(
            f"'formula' is {shown(formula)}; choose one of the glasses that devices/README.md lists, such as "
            f"{', '.join(like)}, or give any glass by 'sellmeier', or by 'nd' and 'vd'."
        )
    return glasses[formula].renamed(name)


def _squared(table: Table, name: str) -> Medium:
    """Read n^2 as terms of Sellmeier, as powers of the wavelength, or as the sum of both."""
    pairs = {key: table.vectors(key, 2) if table.has(key) else np.empty((0, 2)) for key in ("sellmeier", "schott")}
    for key, given in pairs.items():
        if len(given) > _MOST:
            raise table.fail(f"'{key}' has {len(given)} terms; {_MOST} is the most that is read.")
    if np.any(np.abs(pairs["schott"][:, 1]) > _HIGHEST_POWER):
        raise table.fail(
            f"'schott' must be pairs [factor, power of the wavelength], at most {_MOST}, powers within "
            f"{_HIGHEST_POWER}."
        )
    terms, powers = ([(float(first), float(second)) for first, second in given] for given in pairs.values())
    return Medium.squared(name, terms, powers if table.has("schott") else [(1.0, 0.0)])


def _cauchy(table: Table, name: str) -> Medium:
    factors = table.numbers("cauchy")
    if not 1 <= len(factors) <= _HIGHEST_POWER // 4:
        raise table.fail(f"'cauchy' must be 1 to {_HIGHEST_POWER // 4} numbers: A, B, C of n = A + B / L^2 + C / L^4.")
    return Medium.cauchy(name, tuple((factor, -2.0 * place) for place, factor in enumerate(factors.tolist())))


def _abbe(table: Table, name: str) -> Medium:
    index = _index(table, "'nd'", table.number("nd", above=0))
    number = table.number("vd", least=_ABBE_NUMBERS[0], most=_ABBE_NUMBERS[1])
    return Medium.abbe(name, index, number)


_MEDIA: dict[str, Callable[[Table, str], Medium]] = {
    "index": lambda table, name: Medium.constant(name, _index(table, "'index'", table.number("index", above=0))),
    "formula": _named_glass,
    "sellmeier": _squared,
    "schott": _squared,
    "cauchy": _cauchy,
    "nd": _abbe,
}


def _index(table: Table, what: str, index: float) -> float:
    low, high = INDICES
    if not low <= index <= high:
        raise table.fail(f"{what} is {index:g}; a refractive index lies between {low:g} and {high:g}.")
    return index


def _eye(table: Table, frame: FloatArray, media: dict[str, Medium]) -> EyeOptics:
    surfaces: dict[str, PlacedSurface] = {}
    for entry in table.tables("surface", required=False, most=_MOST):
        surface = placed_surface(entry, frame, surfaces)
        surfaces[surface.name] = surface
    display = _path(table.tables("display_path", most=_MOST), surfaces, media)
    see_through = _path(table.tables("see_through_path", most=_MOST), surfaces, media)
    if see_through.steps and see_through.steps[-1].medium is not AIR:
        raise table.fail("'see_through_path' must end in air.")
    panel, eye_box = _panel(table.table("panel"), frame), _eye_box(table.table("eye_box"), frame)
    eye = EyeOptics(display, see_through, panel, eye_box, _field(table))
    used = [shape for surface in eye.surfaces() for shape in base_chain(surface.shape)]
    for name, surface in surfaces.items():
        if not any(shape is surface.shape for shape in used):
            raise table.fail(f"surface '{name}' is in no path; remove it or use it.")
    table.finish()
    return eye


def _path(entries: list[Table], surfaces: dict[str, PlacedSurface], media: dict[str, Medium]) -> Path:
    """Read steps written as { at = surface, do = interaction, into = medium }; `into` is for refractions only."""
    medium = AIR
    steps = []
    for entry in entries:
        surface = surfaces[named(entry, "at", "surface", surfaces)]
        interaction = Interaction(entry.text("do", choices=[str(each) for each in Interaction]))
        if interaction is Interaction.REFRACT:
            medium = media[named(entry, "into", "medium", media)]
        entry.finish()
        steps.append(Step(surface, interaction, medium))
    return Path(tuple(steps))


def _panel(table: Table, frame: FloatArray) -> PlacedPanel:
    counts = table.vector("pixels", 2)
    if not np.all((counts >= 1) & (counts == np.round(counts))):
        raise table.fail("'pixels' must be two whole numbers of at least 1, width and height.")
    require_pixels(f"{table.where} 'pixels'", counts, "correct them")
    size = MM * table.vector("size_mm", 2, least=_PANEL_LEAST_MM, most=_FAR_MM)
    pose = rigid(frame @ axes(table, "u_axis", "v_axis"), frame @ _lengths(table, "centre_mm", 3))
    curvature = table.vector("curvature_per_m", 2, default=(0.0, 0.0))
    panel = PlacedPanel(pose, size, Panel(int(counts[0]), int(counts[1])), curvature)
    table.finish()
    return panel


def _field(table: Table) -> FieldOfView | None:
    """Read the angles from the wearer's view, right and up positive, whatever the file's axes."""
    if not table.has("field_deg"):
        return None
    angles = table.vector("field_deg", 4, least=-_STEEPEST_DEG, most=_STEEPEST_DEG)
    left, right, down, up = np.tan(np.deg2rad(angles))
    if not (left < right and down < up):
        raise table.fail("'field_deg' must be left, right, down, up, each pair ascending; right and up are positive.")
    return FieldOfView(np.array([left, down]), np.array([right, up]))


def _eye_box(table: Table, frame: FloatArray) -> EyeBox:
    size = table.vector("size_mm", 3, above=0.0)
    require_eye_box(f"{table.where}: 'size_mm'", size, "mm")
    box = EyeBox(frame @ _lengths(table, "centre_mm", 3), MM * size)
    if size.max() < _EYE_BOX_LEAST_MM:
        raise table.fail(f"'size_mm' is below {_EYE_BOX_LEAST_MM:g} mm on every axis; is it in metres? Convert it.")
    table.finish()
    return box
