"""Read the factory calibration of a Vive headset from its configuration file: one radial polynomial per colour.

With r the distance from the lens' centre in units of half the eye's image width, a pixel at offset d from the centre
is seen in the direction with offset d / (1 + k1 r^2 + k2 r^4 + k3 r^6) ("DISTORT_DPOLY3").
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wlr_render.errors import BadInputError
from wlr_render.geometry.directions import ARCMIN
from wlr_render.numerics.arrays import FloatArray

CHANNELS = {"red": "distortion_red", "green": "distortion", "blue": "distortion_blue"}


@dataclass(frozen=True)
class RadialColour:
    """One eye's lens.

    Attributes:
        focal: offset per unit tangent, horizontally.
        coefficients: (3 channels R G B, terms) k1, k2, ...
    """

    focal: float
    coefficients: FloatArray

    def tangents(self, offset: FloatArray) -> FloatArray:
        """Return radial tangents (..., 3) of the R, G, B view directions at offsets r (...) from the lens' centre."""
        r = np.asarray(offset)[..., None]
        powers = r[..., None] ** (2 * np.arange(1, self.coefficients.shape[1] + 1))
        return np.asarray(r / (1.0 + np.sum(self.coefficients * powers, axis=-1)) / self.focal)

    def lateral_colour_arcmin(self, offset: FloatArray) -> FloatArray:
        """Return the angle (...) from the red to the blue view direction of a pixel, outwards positive."""
        angle = np.arctan(self.tangents(offset))
        return np.asarray((angle[..., 2] - angle[..., 0]) / ARCMIN)


def read_vive_hmd_config(path: str | Path) -> tuple[RadialColour, ...]:
    """Read the lenses of the left and the right eye.

    Raises:
        BadInputError: the file cannot be read, is not JSON or lacks a colour of an eye.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        eyes = content["tracking_to_eye_transform"]
        return tuple(
            RadialColour(
                float(eye["intrinsics"][0][0]),
                np.array([eye[name]["coeffs"] for name in CHANNELS.values()], dtype=np.float64),
            )
            for eye in eyes
        )
    except OSError as error:
        raise BadInputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (KeyError, IndexError, TypeError) as error:
        raise BadInputError(f"{path}: lacks {error} of an eye; it is not a headset's calibration.") from error
    except ValueError as error:
        raise BadInputError(f"{path}: is not valid JSON with numbers ({error}).") from error
