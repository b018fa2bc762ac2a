"""A lens and a board's shape by joint adjustment of hand-held photographs, and of random halves of the photographs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.published_data.board_sets import PhotographSet
from wlr_render.calibration.bench.adjustment import Adjustment, adjust
from wlr_render.calibration.bench.board_shape import BOARD_SHAPE
from wlr_render.calibration.bench.board_views import EYEBALL, BenchObservations, BoardView, CameraSetup
from wlr_render.calibration.bench.lenses import free_views, sound_views
from wlr_render.calibration.bench.start import start_state
from wlr_render.captures.boards.board import USUAL_TOLERANCES, BoardObservation
from wlr_render.numerics.arrays import FloatArray
from wlr_render.report.blocks import Cell

_FEATURES = 150  # features per photograph in the fit; more features cost time and add little
_SPLITS = 6


def adjusted_row(of: PhotographSet, seen: Sequence[BoardObservation], size_px: tuple[int, int]) -> dict[str, Cell]:
    """Return values with sigmas, and the difference between fits to random halves over its sigma, rms over splits."""
    every = max(1, round(float(np.median([len(each) for each in seen])) / _FEATURES))
    views = []
    for number, each in enumerate(seen):
        few = each.only((each.index @ [1, 2]) % every == 0)
        point = of.board.point_of(few.index)
        views.append(BoardView(f"{number:03d}", EYEBALL, few.index, point, few.pixel, few.sigma_px))
    known = BenchObservations(views, {EYEBALL: CameraSetup(size_px)}, {}, (), tolerances={"board": USUAL_TOLERANCES})
    sound = sound_views(views, known.cameras[EYEBALL], known)
    kind = sound.lens.kind  # type: ignore[attr-defined]
    known = replace(known, cameras={EYEBALL: CameraSetup(size_px, kind)})
    whole = _fit(known, sound.views)
    rng, apart = np.random.default_rng(0), []
    for _ in range(_SPLITS):
        order = rng.permutation(len(sound.views))
        halves = [[sound.views[k] for k in part] for part in np.array_split(order, 2)]
        (one, first), (other, second) = (_values(_fit(known, half)) for half in halves)
        apart.append((one - other) / np.hypot(first, second))
    value, sigma = _values(whole)
    shape = 1e3 * whole.state.shape["board"].low[: len(BOARD_SHAPE)]
    shape_sigma = 1e3 * np.sqrt(np.diag(whole.covariance_of([("shape", "board")])))
    pairs = zip(("fx", "fy", "cx", "cy"), value, sigma, strict=True)
    bows = zip(("bow x", "bow y", "twist"), shape, shape_sigma, strict=False)
    ratios = ", ".join(f"{each:.1f}" for each in np.sqrt(np.mean(np.square(apart), axis=0)))
    return (
        {"set": of.title, "lens": kind}
        | {f"{name} (px)": f"{each:.2f} +- {own:.2f}" for name, each, own in pairs}
        | {f"{name} (mm)": f"{each:.2f} +- {own:.2f}" for name, each, own in bows}
        | {"stretch": f"{whole.sizes['stretch']:.1e}"}
        | {"halves, fx fy cx cy (sigma)": ratios}
    )


def _fit(known: BenchObservations, views: Sequence[BoardView]) -> Adjustment:
    setup = known.cameras[EYEBALL]
    lens = free_views(views, setup, setup.kind, known).lens[EYEBALL]
    return adjust(start_state(replace(known, views=views), {EYEBALL: lens}))


def _values(fit: Adjustment) -> tuple[FloatArray, FloatArray]:
    """Return fx, fy, cx, cy and their sigmas."""
    return fit.state.lens[EYEBALL].values[:4], np.sqrt(np.diag(fit.covariance_of([("lens", EYEBALL)])))[:4]
