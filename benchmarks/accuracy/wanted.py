"""Goals for fits of the shipped devices, rms in arcminutes."""

EXACT, FINE, COARSE = 0.0, 0.25, 1.0
"""Camera noise in arcminutes per axis."""

DISPLAY = {
    "northstar": {EXACT: 0.005, FINE: 0.04, COARSE: 0.12},
    "freeform40": {EXACT: 0.035, FINE: 0.07, COARSE: 0.19},
    "birdbath28": {EXACT: 0.001, FINE: 0.035, COARSE: 0.105},
}
"""Direction of a pixel in the nominal field, 25 camera positions."""
WHOLE_PANEL = {
    "northstar": {EXACT: 0.05, FINE: 0.07},
    "freeform40": {EXACT: 0.08, FINE: 0.10},
    "birdbath28": {EXACT: 0.001, FINE: 0.035},
}
"""Direction of a pixel of the whole panel, 25 camera positions."""
FEW_POSITIONS = {"northstar": {COARSE: 0.16}}
"""Direction of a pixel in the nominal field, 16 camera positions."""
SEE_THROUGH = {
    "northstar": {EXACT: 0.005, COARSE: 0.06},
    "freeform40": {EXACT: 0.02, COARSE: 0.10},
    "birdbath28": {EXACT: 0.0005, COARSE: 0.06},
}
"""Direction of a real point in the nominal field, 25 camera positions."""
GREY_BOX = (
    (25, COARSE, 0.002, 0.08),
    (9, COARSE, 0.002, 0.11),
    (5, COARSE, 0.002, 0.15),
    (5, FINE, 0.002, 0.04),
    (25, COARSE, 0.0, 0.05),
)
"""Camera positions, noise, relative error of the shape, and goal for the direction of a pixel in the nominal field."""
PREDICTED_OVER_TRUE = (0.8, 1.25)
FIT_SECONDS = {25: 3.0, 190: 10.0}
"""Goal for the time of a display fit on one core, by number of camera positions: 13,000 and 100,000 readings."""
STUCK_FACTOR = 2.0
"""Factor: a fit with repeatability or wobble off by more is in a wrong maximum of the evidence."""
