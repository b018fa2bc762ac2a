"""The command line."""

from wlr_render.cli.program import main as main
