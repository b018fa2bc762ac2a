"""Options check themselves: the command line and scripts are refused the same values in the same words."""

from dataclasses import KW_ONLY, dataclass, replace
from typing import Annotated, Literal

import numpy as np
import pytest

from wlr_render.errors import BadInputError
from wlr_render.jobs.options import OnlyWith, Options, Range, described


@dataclass(frozen=True)
class DrawOptions(Options):
    scene: Annotated[str, described("A scene.")]
    _: KW_ONLY
    method: Annotated[Literal["raster", "rays"], described("Method.")] = "raster"
    shadows: Annotated[bool, described("Shadows.", flag=True), OnlyWith("method", ("rays",))] = False
    rate: Annotated[float, described("Rate.", name="--fps"), Range(above=0)] = 30.0
    depths_m: Annotated[tuple[float, ...], described("Depths."), Range(at_least=0.1, at_most=10)] = (1.0, 2.0)
    limit: Annotated[int | None, described("Limit."), Range(at_least=1)] = None


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"rate": 0.0}, "--fps is 0.0; it must be a finite number above 0."),
        ({"rate": np.nan}, "--fps is nan; it must be a finite number above 0."),
        ({"depths_m": (1.0, 11.0)}, "--depths-m is 11.0; it must be between 0.1 and 10."),
        ({"limit": 0}, "--limit is 0; it must be a finite number of 1 or more."),
        ({"shadows": True}, "--shadows is used with --method rays only; leave it out, or give --method rays."),
    ],
)
def test_values_out_of_range_and_unused_options_are_refused(values, sentence):
    with pytest.raises(BadInputError) as refused:
        DrawOptions("desk", **values)
    assert str(refused.value) == sentence


def test_good_values_pass():
    options = DrawOptions("desk", method="rays", shadows=True, rate=0.5, limit=1)
    assert replace(options, limit=3).limit == 3
