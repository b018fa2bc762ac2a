"""All procedural meshes by name, for scene files: a shape is a function whose keyword arguments are the file's keys.

To add one: write a function in this folder with a default for each argument (lengths end in `_m`, colours are linear
RGB), and give it a line here and in scenes/README.md.
"""

from collections.abc import Callable

from wlr_render.rendering.scene import Mesh
from wlr_render.rendering.shapes import basic, furniture, sculpture

SHAPES: dict[str, Callable[..., Mesh]] = {
    "ball": basic.ball,
    "book": furniture.book,
    "box": basic.box,
    "dot_board": basic.dot_board,
    "keyboard": furniture.keyboard,
    "lamp": furniture.lamp,
    "monitor": furniture.monitor,
    "monitor_screen": furniture.monitor_screen,
    "mug": furniture.mug,
    "picture": furniture.picture,
    "plane": basic.plane,
    "plant": furniture.plant,
    "plinth": sculpture.plinth,
    "sculpture": sculpture.sculpture,
    "sphere": basic.sphere,
    "tabletop": furniture.tabletop,
}
