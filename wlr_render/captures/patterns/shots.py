"""The photographs of a set, taken one at a time in the order of showing."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.photographs import Photograph
from wlr_render.errors import BadInputError

Grey = NDArray[np.float32]


class Shots:
    """Photographs of one size, one per name; none is kept.

    They are numbered from 0, as `Pattern.image` and the files of `show_page` are.
    """

    def __init__(self, photographs: Iterable[Photograph], names: Sequence[str]) -> None:
        self._source = iter(photographs)
        self._names = names
        self._peak: Photograph | None = None
        self.taken = 0

    @property
    def peak(self) -> Photograph:
        """(h, w) the brightest value that any photograph so far has."""
        if self._peak is None:
            raise ValueError("no photograph was taken yet")
        return self._peak

    def label(self, index: int) -> str:
        """How a sentence calls a photograph: photograph 12 ('u bit 5')."""
        return f"photograph {index} ('{self._names[index]}')"

    def take(self) -> Grey:
        """The next photograph, (h, w) float32 grey values.

        Raises:
            BadInputError: there is none left, or it has another size or depth than those before.
        """
        label = self.label(self.taken)
        image = next(self._source, None)
        if image is None:
            raise BadInputError(
                f"{label} is missing: there are {self.taken} photographs for {len(self._names)} pictures shown."
            )
        if self._peak is None:
            self._peak = _grey_integers(image, label).copy()
        elif image.shape != self._peak.shape or image.dtype != self._peak.dtype:
            raise BadInputError(
                f"{label} is {_kind(image)}, but those before it are {_kind(self._peak)}; take it again."
            )
        np.maximum(self._peak, image, out=self._peak)
        self.taken += 1
        return image.astype(np.float32)

    def finish(self) -> None:
        """See that no photograph is left over.

        Raises:
            BadInputError: there is one.
        """
        if next(self._source, None) is not None:
            raise BadInputError(
                f"There are more photographs than the {len(self._names)} pictures shown; the last should be "
                f"{self.label(len(self._names) - 1)}."
            )


def _grey_integers(image: Photograph, label: str) -> Photograph:
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise BadInputError(
            f"{label} must be a grey picture of 8 or 16 bits, not {image.dtype} of shape {image.shape}."
        )
    return image


def _kind(image: Photograph) -> str:
    return f"{' x '.join(map(str, image.shape[::-1]))} pixels of {8 * image.itemsize} bits"
