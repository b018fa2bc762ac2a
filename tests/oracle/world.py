"""The bench as it truly is: a headset of the second tracer, and at every station what an effect does there."""

from collections.abc import Callable
from dataclasses import dataclass

from oracle.captures import Captures
from oracle.devices import OwnDevice
from oracle.own_tracer import FloatArray

Place = Callable[[FloatArray, Captures], FloatArray]
"""Camera positions (c, 3) that were believed -> those that are true."""

Turn = Callable[[Captures], FloatArray]
"""Rotation matrices (3, 3) or (c, 3, 3) by which the camera is turned from looking along z."""

Image = Callable[[FloatArray, FloatArray], FloatArray]
"""Camera pixels (n, 2) of a perfect pinhole, seconds (n,) -> pixels at which the camera has them."""

Decode = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Panel pixels (n, 2), seconds (n,), channel (n,) -> panel pixels that are decoded."""

Print = Callable[[FloatArray, FloatArray], FloatArray]
"""Dots on the target (n, 3), half the target's size (2,) -> dots where they are."""

Pose = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Rotation (3, 3), translation (3,) of a target in the device, as tracked -> the true ones."""

Beyond = Callable[[FloatArray, FloatArray], FloatArray]
"""Rays behind the optics: origins (n, 3), unit directions (n, 3) -> origins of the same directions farther out."""

Pupil = Callable[[FloatArray, FloatArray], FloatArray]
"""Places of the pupil (n, 3) that were believed, unit directions of gaze (n, 3) -> places that are true."""

Late = Callable[[FloatArray], FloatArray]
"""Places (n, 2) on the panel or in the camera's image, 0 at the first column and row and 1 at the last -> seconds (n,)
by which they are seen late."""

Flex = Callable[[FloatArray, FloatArray], FloatArray]
"""Unit directions of gravity in the device (n, 3), seconds (n,) -> rotation matrices (n, 3, 3) of the picture."""


@dataclass(frozen=True, eq=False)
class World:
    """A bench; millimetres, x right, y down, z forward.

    Attributes:
        device: the headset.
        place: what the stage and the camera's mount do to the camera's position, in turn.
        turn: what turns the camera, the last one outermost.
        image: what the lens and the sensor do, in turn.
        decode: what happens between the place on the panel and its decoded pixel, in turn.
        print: what is wrong with the targets' dots, in turn.
        pose: what the tracking camera gets wrong, in turn.
        beyond: elements between the optics and the world, from the eye outwards.
        pupil: what eye tracking gets wrong, in turn.
        late: delays of the picture by places on the panel, which add up.
        shutter: delays of the camera by places in its image, which add up.
        flex: what turns the picture against the camera while the glasses move, the last one outermost.
    """

    device: OwnDevice
    place: tuple[Place, ...] = ()
    turn: tuple[Turn, ...] = ()
    image: tuple[Image, ...] = ()
    decode: tuple[Decode, ...] = ()
    print: tuple[Print, ...] = ()
    pose: tuple[Pose, ...] = ()
    beyond: tuple[Beyond, ...] = ()
    pupil: tuple[Pupil, ...] = ()
    late: tuple[Late, ...] = ()
    shutter: tuple[Late, ...] = ()
    flex: tuple[Flex, ...] = ()
