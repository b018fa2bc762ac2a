"""`python -m benchmarks NAME [OPTIONS]`: run one benchmark of the program and print its report."""

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from wlr_render.__main__ import run_program

if TYPE_CHECKING:
    from cyclopts import App

BENCHMARKS = {
    "speed": "Speed of frames, offline and in real time, against baselines, and their accuracy.",
    "submission": "CPU cost of a frame: time of submission without drawing, OpenGL calls, allocations.",
    "soak": "Soak test: many frames for a moving wearer; frame times, memory, map errors.",
    "kills": "Jobs that are killed at random moments and resumed, compared with undisturbed ones.",
    "diagnosis": "Diagnoses of simulated sessions with hidden effects, scored.",
    "simulated-lab": "Simulated photographs: readings, calibrations and corrected displays, compared with the truth.",
    "budget": "Predicted covariance of registration against true errors of simulated sessions.",
    "published-data": "Published data sets: converted, decoded, display models and detectors of boards on them.",
    "accuracy": "Errors of fitted models by camera positions, noise and stage, compared with predicted errors.",
    "design": "Errors of simulated sessions by the design of their camera places.",
    "wear": "Self-calibration by clicks over half an hour of simulated wear with slips.",
    "paper": "Planar against volumetric sampling of display and see-through, in simulation.",
    "raster": "Rasterised frames, and the paper's raster, compared with ray tracing pixel by pixel.",
    "renderers": "Other renderers on a headset's rays, compared with Embree.",
    "exports": "Other programs that read exports, compared with our own maps.",
    "rivals": "Published methods and ours on the same captures, simulated or measured by others.",
    "monado": "Monado's compositor with an exported distortion, compared with our own map.",
}
"""Help texts; each benchmark is the function `run` of `study.py` in its folder."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one benchmark; return the exit status: 0, 2 for bad input, or 130 or 143 if interrupted."""
    from wlr_render.cli import run_app

    return run_app(make_app, arguments)


def make_app() -> "App":
    """Return the parser of the command line; a benchmark's module is imported when it is used."""
    from cyclopts import App, Parameter

    app = App(
        name="benchmarks",
        usage="python -m benchmarks NAME [OPTIONS]",
        help="Benchmarks of the program; benchmarks/README.md says what each measures and how long it takes.",
        version_flags=(),
        default_parameter=Parameter(negative=()),
    )
    for name, text in BENCHMARKS.items():
        app.command(f"benchmarks.{name.replace('-', '_')}.study:run", name=name, help=text)
    return app


if __name__ == "__main__":
    sys.exit(run_program(main))
