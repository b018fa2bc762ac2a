"""The target was printed larger or smaller than stated."""

from dataclasses import replace

from wlr_render.diagnosis.cause import Cause, Parameter
from wlr_render.numerics.arrays import FloatArray
from wlr_render.simulation.bench import Bench


def _scaled(bench: Bench, scale_percent: FloatArray) -> Bench:
    scale = bench.target.scale * (1.0 + 1e-2 * scale_percent)
    return replace(bench, target=replace(bench.target, scale=scale))


CAUSE = Cause(
    "target_scale",
    "printed size of the target",
    "target",
    (Parameter("scale_x", "%", 0.3), Parameter("scale_y", "%", 0.3)),
    source="printers are off by about 0.4 %",
    separated_by="a ruler on the print",
    variants={"about its middle": _scaled},
    remedy="enter it in bench.toml as [target] scale, as the extended bench has it, or print the target anew",
)
