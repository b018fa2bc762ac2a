"""Checks of an adjusted bench, which find the step of the procedure that contradicts the others, and its remedy."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy

from wlr_render.calibration.bench.adjustment import Adjustment
from wlr_render.calibration.bench.bench_blocks import USUAL_SIZES, Key
from wlr_render.calibration.bench.board_shape import BOARD_SHAPE
from wlr_render.calibration.bench.board_views import EYEBALL, BoardView
from wlr_render.calibration.bench.faults import NEGLIGIBLE_M, NEGLIGIBLE_RAD, SINGLE, Fault
from wlr_render.calibration.bench.normal_equations import residuals_of
from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray

STEP = "photographs without the headset"

REFUSED_MM, REFUSED_ARCMIN = 1.0, 10.0  # least motions that make a calibration wrong: 7' and 10' of a target at 0.5 m
_UNLIKELY = 1e-4  # probability below which chance is excluded; ten checks warn in one of 1,000 sessions
_SCALE, _REFUSED_SCALE = 0.002, 0.02  # relative scale errors: 1 and 10 mm in the distance of a target at 0.5 m
_SKEW_DEG = 1.0  # largest departure of two axes from a right angle; stages screwed together keep a tenth
_UNIT = 0.1  # largest distance from a factor of 1000, in powers of ten, of a mistaken unit
_NOISE_DIFFERS = 0.7  # sigma of the logarithm of the stated noise: a factor of 2
_NAMED = 2  # number of worst-fitting photographs that are named
_CAMERAS = {EYEBALL: "eyeball camera", "tracking": "tracking camera"}


@dataclass(frozen=True)
class Check:
    """Result of checking one quantity.

    Attributes:
        step: step of the procedure, or photograph, that the check concerns.
        quantity: quantity with its unit.
        value: estimate; `sigma`: its standard deviation; `limit`: largest acceptable magnitude.
        sentence: the problem and its remedy, or a statement that the value is right.
        ok: True if the value is within the limit or within its uncertainty.
        contradictory: True if the value is so far off that a calibration with it would be wrong.
    """

    step: str
    quantity: str
    value: float
    sigma: float
    limit: float
    sentence: str
    ok: bool
    contradictory: bool = False


@dataclass(frozen=True)
class Pull:
    """Chi-squared of readings or prior knowledge of one kind relative to the solution.

    Attributes:
        kind: kind of reading or knowledge.
        chi_square: sum of squares in units of sigma. freedom: expectation of this sum.
        probability: probability of a value this extreme by chance.
    """

    kind: str
    chi_square: float
    freedom: float
    probability: float

    @property
    def reduced(self) -> float:
        """Reduced chi-squared."""
        return self.chi_square / max(self.freedom, 1e-9)


def significance(chi_square: float, freedom: int) -> float:
    """Return the number of sigmas of a normal variable with the same probability as this chi-squared."""
    probability = float(scipy.special.chdtrc(freedom, chi_square))
    if probability > 1e-300:
        return float(max(-scipy.special.ndtri(0.5 * probability), 0.0))
    half, x = 0.5 * freedom, 0.5 * chi_square  # tail of the incomplete gamma function
    return float(np.sqrt(2.0 * (x - (half - 1.0) * np.log(x) + scipy.special.gammaln(half))))


def refuse_contradictions(checks: Iterable[Check]) -> None:
    """Refuse a bench with a contradictory check.

    Raises:
        BadInputError: a check is contradictory; the message names its step.
    """
    off = [check for check in checks if check.contradictory]
    if off:
        more = f" ({len(off) - 1} more checks contradict each other as well)" if len(off) > 1 else ""
        raise BadInputError(f"{off[0].step}: {off[0].sentence}{more}.")


def bench_checks(adjustment: Adjustment, faults: Sequence[Fault]) -> list[Check]:
    """Check an adjusted bench."""
    return [
        *(_fault_check(fault) for fault in faults if fault.kind != "tracking"),
        *(_noise_check(adjustment, name) for name in _by_noise(adjustment)),
        *([] if adjustment.is_settled else [_unsettled_check()]),
        *_stage_checks(adjustment),
        *_scales(adjustment),
        *_angles(adjustment),
        *(_pull_check(pull) for pull in prior_pulls(adjustment)),
    ]


def prior_pulls(adjustment: Adjustment) -> list[Pull]:
    """Compare adjusted values with their priors: extrinsics, given targets, known lenses and shapes of boards."""
    state, seen = adjustment.state, adjustment.state.observations
    named: dict[str, Key] = {}
    if seen.device_from_tracking is not None:
        named["pose of the tracking camera"] = ("extrinsics", "tracking")
    named |= {f"given pose of target {number}": ("target", number) for number in seen.targets}
    known = [name for name, setup in seen.cameras.items() if setup.calibrated is not None and name in state.lens]
    named |= {f"known lens of the {_CAMERAS[name]}": ("lens", name) for name in known}
    named |= {f"shape of the {name}": ("shape", name) for name in state.shape}
    pulls = []
    for kind, key in named.items():
        where = adjustment.layout.where[key]
        if key[0] == "shape":  # the size of the smooth fields is estimated
            where = slice(where.start, where.start + len(BOARD_SHAPE))
        prior = np.diag(adjustment.layout.size[where] ** 2)
        # Covariance of adjusted minus prior value; zero in directions that the views do not constrain.
        size, vectors = np.linalg.eigh(np.eye(len(prior)) - _scaled(adjustment.covariance[where, where], prior))
        learnt = size > 1e-3
        away = vectors.T @ (state.deviation([key])[: len(prior)] / np.sqrt(np.diag(prior)))
        chi_square = float(np.sum(away[learnt] ** 2 / size[learnt]))
        freedom = int(np.count_nonzero(learnt))
        if freedom:
            pulls.append(Pull(kind, chi_square, freedom, float(scipy.special.chdtrc(freedom, chi_square))))
    return pulls


def _scaled(covariance: FloatArray, prior: FloatArray) -> FloatArray:
    per = 1.0 / np.sqrt(np.diag(prior))
    return per[:, None] * covariance * per


def reading_pulls(adjustment: Adjustment) -> list[Pull]:
    """Return the chi-squared of the features by camera, for stated sigmas, and of the stage's random errors."""
    normal, pulls = adjustment.normal, []
    for name, reduced in adjustment.chi_square.items():
        freedom = float(normal.values[name])
        # Stated sigmas are uncertain by a factor, so that the test uses the logarithm of the noise ratio.
        chance = 2.0 * float(scipy.special.ndtr(-abs(0.5 * np.log(max(reduced, 1e-12))) / _NOISE_DIFFERS))
        pulls.append(Pull(f"board features, {_CAMERAS[name]}", reduced * freedom, freedom, chance))
    offsets = np.array(list(adjustment.state.of("offset").values())).reshape(-1, 6)
    if len(offsets):
        for kind, part, size in (
            ("rotation of the stage", slice(0, 3), adjustment.sizes["turn"]),
            ("position of the stage", slice(3, 6), adjustment.sizes["shift"]),
        ):
            columns = [adjustment.layout.where["offset", place] for place in adjustment.state.of("offset")]
            variance = np.array([np.diag(adjustment.covariance[where, where])[part] for where in columns])
            freedom = float(np.sum(1.0 - np.minimum(variance / size**2, 1.0)))
            chi_square = float(np.sum(offsets[:, part] ** 2)) / size**2
            pulls.append(Pull(kind, chi_square, freedom, float(scipy.special.chdtrc(max(freedom, 1e-9), chi_square))))
    return pulls


def _fault_check(fault: Fault) -> Check:
    turn_arcmin, shift_mm = np.linalg.norm(fault.motion[:3]) / ARCMIN, 1e3 * np.linalg.norm(fault.motion[3:])
    sentence = (
        f"photographs disagree by {shift_mm:.3g} mm and {turn_arcmin:.2g}': {_explained(fault)}; {_remedy(fault)}"
    )
    turned = turn_arcmin * ARCMIN / NEGLIGIBLE_RAD > 1e-3 * shift_mm / NEGLIGIBLE_M
    large = fault.kind not in SINGLE and (shift_mm > REFUSED_MM or turn_arcmin > REFUSED_ARCMIN)
    value, limit = (turn_arcmin, NEGLIGIBLE_RAD / ARCMIN) if turned else (shift_mm, 1e3 * NEGLIGIBLE_M)
    sigmas = max(float(np.sqrt(2.0 * fault.log_odds)), 1.0)
    step = " and ".join(fault.names) if fault.kind in SINGLE else STEP
    quantity = "turn, arcmin" if turned else "shift, mm"
    return Check(
        step, quantity, float(value), float(value) / sigmas, limit, sentence, ok=False, contradictory=bool(large)
    )


def _explained(fault: Fault) -> str:
    """Return the explanations that the views cannot distinguish, most probable first, with their probabilities."""
    odds: dict[str, float] = {}
    for each in (fault, *fault.alternatives):
        odds[_moved(each)] = odds.get(_moved(each), 0.0) + float(np.exp(each.log_odds - fault.log_odds))
    if len(odds) == 1:
        return next(iter(odds))
    ranked = sorted(odds, key=lambda motion: -odds[motion])
    return "either " + "; or ".join(f"{motion} ({100 * odds[motion] / sum(odds.values()):.0f} %)" for motion in ranked)


def _remedy(fault: Fault) -> str:
    """Describe other causes with the appearance of a fault, and the remedy."""
    if fault.kind == "photograph":
        return "the photograph was rejected: compare it with its entry, or take it again"
    if fault.kind == "exchange":
        return "both were rejected: compare them with their entries, or take them again"
    return (
        "a lens of another kind or focus, a wrong scale of board or stage, dots of very few pixels, or exchanged "
        "photographs look much the same: rule these out, then take the photographs again"
    )


def _moved(fault: Fault) -> str:
    if fault.kind == "photograph":
        return f"the target or the camera moved at {fault.names[0]}, or its stage reading is another"
    before, after = fault.names
    if fault.kind == "exchange":
        return f"the stage readings of {before} and {after} look exchanged"
    if fault.kind == "target in bare":
        return f"the target moved at pose {fault.target} between {before} and {after}"
    if fault.kind == "camera in bare":
        return f"the camera moved on its stage between {before} and {after}"
    return (
        f"the target moved at pose {fault.target} between its photographs without the headset ({before}) and by the "
        f"tracking camera ({after})"
    )


def _stage_checks(adjustment: Adjustment) -> list[Check]:
    """Check the stage's errors against the range of ordinary stages."""
    if not adjustment.state.of("offset"):
        return []
    sizes, checks = adjustment.sizes, []
    rows = (
        ("repeatability in position", "shift", 1e6 * sizes["shift"], "um", 1e3 * sizes["shift"] > REFUSED_MM),
        ("repeatability in rotation", "turn", 1e6 * sizes["turn"], "urad", sizes["turn"] / ARCMIN > REFUSED_ARCMIN),
        ("smooth error in position", "smooth shift", 1e6 * sizes["smooth shift"], "um", False),
        ("smooth error in rotation", "smooth turn", 1e6 * sizes["smooth turn"], "urad", False),
    )
    for quantity, name, value, unit, refused in rows:
        limit = 1e6 * USUAL_SIZES[name].value * float(np.exp(2.5 * USUAL_SIZES[name].log_sigma))
        relative = 1.0 / np.sqrt(6.0 * len(adjustment.state.of("offset")))
        ok = value <= limit
        sentence = f"the stage's {quantity} is {value:.2g} {unit} per axis"
        if not ok:
            sentence += (
                f", far beyond ordinary stages (up to {limit:.0f} {unit}); check stage readings, target poses and "
                "units, and that stage, camera and target are fixed"
            )
        checks.append(
            Check(STEP, f"{quantity}, {unit}", value, value * relative, limit, sentence, ok, contradictory=refused)
        )
    return checks


def _scales(adjustment: Adjustment) -> list[Check]:
    checks = []
    for number, axis in enumerate(adjustment.state.observations.axes):
        vector = adjustment.state.twists[number, 3:]
        length = float(np.linalg.norm(vector))
        if axis.kind != "linear" or length == 0.0:
            continue
        where = adjustment.layout.where["axis", number]
        covariance = adjustment.covariance[where, where][3:, 3:]
        sigma = float(np.sqrt(vector @ covariance @ vector)) / length
        off = abs(length - 1.0)
        ok = off <= _SCALE + 3.0 * sigma
        name = "xyz"[number] if number < 3 else str(number + 1)
        checks.append(
            Check(
                STEP,
                f"travel along axis {name} by the board's pitch / reading, minus 1",
                length - 1.0,
                sigma,
                _SCALE,
                _scale_sentence(name, length, ok),
                ok,
                contradictory=off > _REFUSED_SCALE + 6.0 * sigma,
            )
        )
    return checks


def _scale_sentence(axis: str, length: float, ok: bool) -> str:
    if ok:
        return f"the stage's axis {axis} and the board's pitch agree to {100 * (length - 1):+.2g} %"
    if abs(abs(np.log10(length)) - 3) < _UNIT:
        wrong = "small, as metres read as millimetres are" if length > 1 else "large, as millimetres read as metres are"
        return (
            f"the stage readings along axis {axis} are 1000 times too {wrong} (or the board's pitch is in another "
            "unit); correct the unit in the session file"
        )
    return (
        f"1 mm of the stage's axis {axis} is {length:.4g} mm by the board's printed pitch; measure the pitch over many "
        "features with a rule (printers scale to fit the page), or correct the scale of the stage"
    )


def _angles(adjustment: Adjustment) -> list[Check]:
    checks, twists = [], adjustment.state.twists
    axes = adjustment.state.observations.axes
    linear = [k for k, axis in enumerate(axes) if axis.kind == "linear" and np.any(twists[k])]
    for i, j in combinations(linear, 2):
        first, second = twists[i, 3:], twists[j, 3:]
        size = np.linalg.norm(first) * np.linalg.norm(second)
        skew_deg = float(np.degrees(np.arcsin(first @ second / size)))
        none = np.zeros(3)
        gradient = np.concatenate([none, second, none, first]) / size
        covariance = adjustment.covariance_of([("axis", i), ("axis", j)])
        sigma_deg = float(np.degrees(np.sqrt(gradient @ covariance @ gradient)))
        ok = abs(skew_deg) <= _SKEW_DEG + 3.0 * sigma_deg
        pair = " and ".join("xyz"[k] if k < 3 else str(k + 1) for k in (i, j))
        sentence = f"the stage's axes {pair} are {90 - skew_deg:.2f} deg apart"
        if not ok:
            sentence += "; they should be at right angles: are readings of two axes mixed up, or is the stage loose?"
        checks.append(Check(STEP, f"angle of axes {pair} minus 90, deg", -skew_deg, sigma_deg, _SKEW_DEG, sentence, ok))
    return checks


def _by_noise(adjustment: Adjustment) -> list[str]:
    """Return the names of cameras that saw a board, in descending order of noise relative to the stated sigma."""
    return sorted(adjustment.chi_square, key=lambda name: -adjustment.sizes.noise[name])


def _worst_views(adjustment: Adjustment, camera: str) -> list[str]:
    """Return the names of the two worst-fitting photographs."""
    state = adjustment.state
    views = [view for view in state.observations.views if view.camera == camera]

    def misfit(view: BoardView) -> float:
        residual = residuals_of(state, view).residual / view.sigma_px[:, None]
        return float(np.sqrt(np.mean(np.where(np.isfinite(residual), residual, np.inf) ** 2)))

    return [view.name for view in sorted(views, key=misfit)[: -_NAMED - 1 : -1]]


def _noise_check(adjustment: Adjustment, name: str) -> Check:
    """Compare the features' noise with the detector's stated sigmas."""
    noise = adjustment.sizes.noise[name]
    limit = float(np.exp(3.5 * _NOISE_DIFFERS))
    rms = np.sqrt(
        np.mean(np.concatenate([v.sigma_px for v in adjustment.state.observations.views if v.camera == name]) ** 2)
    )
    ok = noise <= limit
    sentence = f"features of the {_CAMERAS[name]} scatter by {noise * rms:.2g} px, {noise:.2f} times their stated sigma"
    if not ok:
        sentence += (
            f"; {' and '.join(_worst_views(adjustment, name))} fit worst: are they of the target pose and stage "
            "reading that session.toml states? Or focal length, centre or distortion are not this camera's, its kind "
            "of lens does not fit it, or the board is not the one in the board file"
        )
    sigma = noise / float(np.sqrt(2.0 * adjustment.normal.values[name]))
    return Check(
        f"photographs by the {_CAMERAS[name]}",
        "noise / stated sigma",
        noise,
        sigma,
        limit,
        sentence,
        ok,
        noise > 2.0 * limit,
    )


def _unsettled_check() -> Check:
    """Return the check of a search for the bench that ended without a minimum."""
    sentence = (
        "no cameras, lenses and poses fit the photographs: one that shows another target pose, or was taken at another "
        "stage reading than session.toml states, does that; leave out half of them to find it"
    )
    return Check("all photographs", "search for the bench", np.nan, np.nan, np.nan, sentence, False, True)


def _pull_check(pull: Pull) -> Check:
    ok = pull.probability >= _UNLIKELY
    far = significance(pull.chi_square, int(pull.freedom))
    sentence = f"the {pull.kind} agrees with what is stated (reduced chi-squared {pull.reduced:.2g})"
    if not ok:
        sentence = (
            f"the {pull.kind} contradicts what is stated by {far:.0f} sigma; correct it, or state a larger sigma for it"
        )
    return Check(f"{pull.kind}", "reduced chi-squared", pull.reduced, np.sqrt(2.0 / pull.freedom), 1.0, sentence, ok)
