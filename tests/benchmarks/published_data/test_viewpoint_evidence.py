"""Displays of known kinds: points in space, pictures at infinity, twisted bundles, and a rig that turned."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmarks.published_data.viewpoint_evidence import EyeEvidence, ModelEvidence, rms, viewpoint_evidence
from wlr_render.captures.correspondences import DisplayCaptures
from wlr_render.geometry.directions import ARCMIN, dir_of_tangents, normalised, tangents_of_dir
from wlr_render.geometry.transforms import rotate, rotation_about
from wlr_render.mappings import EyeBox, Panel
from wlr_render.numerics.arrays import FloatArray

PANEL = Panel(160, 160)
HALF_BASELINE_M = 0.011
SIGMA_ARCMIN = 1.0
TWIST = 30 * ARCMIN


def captured(
    view_dir: Callable[..., Any],
    eye: str = "left",
    heights: tuple[float, float] = (-HALF_BASELINE_M, HALF_BASELINE_M),
    rows_per_view: int = 4000,
) -> DisplayCaptures:
    """Captures of random pixels; `view_dir(unit, viewpoint)` with unit panel coordinates -1..1, x mirrored for the
    right eye."""
    rng = np.random.default_rng(7)
    side = 1.0 if eye == "left" else -1.0
    viewpoint = np.array([[-0.03 * side, height, 0.0] for height in heights])
    capture = np.repeat(np.arange(len(heights)), rows_per_view)
    pixel = rng.uniform(0, 160, (len(capture), 2))
    mirrored = (pixel / 80 - 1) * [side, 1.0]
    # The left eye's optics, and its picture in the mirror x -> -x.
    seen = view_dir(mirrored, viewpoint[capture] * [side, 1, 1]) * [side, 1, 1]
    noisy = tangents_of_dir(normalised(seen)) + rng.normal(0, SIGMA_ARCMIN * ARCMIN, pixel.shape)
    return DisplayCaptures(
        device="toy",
        eye=eye,
        eye_box=EyeBox(viewpoint.mean(axis=0), np.ptp(viewpoint, axis=0)),
        panel=PANEL,
        viewpoint=viewpoint[capture],
        view_dir=dir_of_tangents(noisy),
        pixel=pixel,
        capture=capture,
        sigma_arcmin=np.array(SIGMA_ARCMIN),
    )


def curved_image(unit: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """One point in space per pixel, at 0.4 m to 0.55 m."""
    depth = 0.4 + 0.15 * unit[:, :1] ** 2
    point = np.hstack([0.3 * unit * [1, -1] * depth, -depth])
    return point - viewpoint


def twisted(unit: FloatArray, viewpoint: FloatArray) -> FloatArray:
    """The points again, but seen from above each is displaced sideways by an angle: no point fits both."""
    seen = tangents_of_dir(curved_image(unit, viewpoint))
    return dir_of_tangents(seen + np.outer(np.sign(viewpoint[:, 1]), [TWIST / 2, 0.0]))


def by_name(evidence: EyeEvidence) -> dict[str, ModelEvidence]:
    return {model.name: model for model in evidence.models}


def noise_rms() -> Any:
    """Of the two components of a direction; tangents far from the axis are a little less than angles."""
    return pytest.approx(np.sqrt(2) * SIGMA_ARCMIN, rel=0.15)


@pytest.mark.slow
def test_points_in_space_are_told_from_a_fixed_picture() -> None:
    (eye,) = viewpoint_evidence([captured(curved_image)]).eyes
    models = by_name(eye)
    assert eye.noise_arcmin == noise_rms()
    assert models["one 3-D point per pixel"].held_out_arcmin == noise_rms()
    assert models["bundle of rays"].held_out_arcmin == noise_rms()
    # Half the parallax of 22 mm at some 0.45 m is 84'.
    assert models["viewpoint ignored"].held_out_arcmin > 40
    assert rms(eye.misclosure_arcmin) < 3 * eye.misclosure_sigma_arcmin
    unit = np.stack([eye.cell % 16, eye.cell // 16], axis=-1) / 8 - 15 / 16
    distance = np.linalg.norm(curved_image(unit, np.array([0.0, -HALF_BASELINE_M, 0.0])), axis=-1)
    np.testing.assert_allclose(1 / eye.image_dioptre, distance, rtol=0.02)


@pytest.mark.slow
def test_a_twisted_bundle_is_not_a_set_of_points() -> None:
    (eye,) = viewpoint_evidence([captured(twisted)]).eyes
    models = by_name(eye)
    assert models["bundle of rays"].held_out_arcmin == noise_rms()
    # Each viewpoint is half the twist away from the best point.
    assert models["one 3-D point per pixel"].held_out_arcmin == pytest.approx(15, rel=0.1)
    assert rms(eye.misclosure_arcmin) == pytest.approx(30, rel=0.1)


@pytest.mark.slow
def test_the_mirror_tells_optics_from_rig() -> None:
    optics = viewpoint_evidence([captured(twisted, "left"), captured(twisted, "right")]).split
    assert optics is not None
    assert optics.optics_arcmin == pytest.approx(30, rel=0.1)
    assert optics.rig_arcmin < 1

    turned = []
    for eye in ("left", "right"):
        captures = captured(curved_image, eye)
        above = captures.capture == 1
        view_dir = captures.view_dir.copy()
        view_dir[above] = rotate(rotation_about("y", TWIST), view_dir[above])
        turned.append(DisplayCaptures(**{**vars(captures), "view_dir": view_dir}))
    rig = viewpoint_evidence(turned).split
    assert rig is not None
    assert rig.rig_arcmin == pytest.approx(30, rel=0.1)
    assert rig.optics_arcmin < 1
