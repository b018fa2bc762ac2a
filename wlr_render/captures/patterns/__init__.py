"""Codes shown on a panel. Each family is one file that keeps the law of `pattern.Pattern`; to add one, name it here."""

from wlr_render.captures.patterns.fringes import Fringes
from wlr_render.captures.patterns.gray_code import GrayCode
from wlr_render.captures.patterns.gray_fringes import GrayFringes

PATTERNS = {
    "gray": GrayCode,
    "fringes": Fringes,
    "gray-fringes": GrayFringes,
}
