"""The paper's claim and figures: planar against volumetric sampling in simulation."""
