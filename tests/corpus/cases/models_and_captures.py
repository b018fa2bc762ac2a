"""Model files and capture files whose structure is sound and whose content is not."""

import io
import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from corpus.case import Case, Change, edited
from corpus.damage import HUGE

RENDER = ("render", "model.json", "scene.toml", "--backend", "cpu", "--out", "out")
FILES = ("model.json", "scene.toml", "box.obj")
FIT = ("calibrate", "captures.npz", "--degree", "1", "--see-through-degree", "1", "--out", "out")
DIAGNOSE = ("diagnose", "captures.npz", "--max-causes", "0", "--out", "out")


def _json(change: Callable[[Any], object]) -> Change:
    def edit(content: bytes) -> bytes:
        model = json.loads(content)
        change(model)
        return json.dumps(model).encode()

    return edited("model.json", edit)


def _eye(change: Callable[[Any], object]) -> Change:
    return _json(lambda model: change(model["eyes"][0]))


def _set(table: Any, *keys_and_value: Any) -> None:
    *keys, last, value = keys_and_value
    for key in keys:
        table = table[key]
    table[last] = value


def _values(part: str, polynomial: str, make: Callable[[int, list[float]], Any]) -> Change:
    def change(eye: Any) -> None:
        for index, term in enumerate(eye[part][polynomial]["terms"]):
            term["values"] = make(index, term["values"])

    return _eye(change)


MODELS: dict[str, tuple[Change, tuple[str, ...]]] = {
    "a coefficient is a huge integer": (_values("display", "forward", lambda k, v: [HUGE] * len(v) if k == 3 else v), ("model.json",)),
    "a coefficient is text": (_values("display", "forward", lambda k, v: ["x"] * len(v) if k == 3 else v), ("model.json", "values|terms")),
    "the see-through is 1e308": (_values("see_through", "deviation", lambda _, v: [1e308] * len(v)), ("model.json",)),
    "the see-through is a million": (_values("see_through", "deviation", lambda _, v: [1e6] * len(v)), ("model.json",)),
    "the start is 1e308": (_values("display", "backward_start", lambda _, v: [1e308] * len(v)), ("model.json",)),
    "orders of 1e9": (_eye(lambda eye: _set(eye, "display", "forward", "terms", 0, "orders", [10**9, 0, 0, 0])), ("model.json", "orders|terms")),
    "an order too few": (_eye(lambda eye: _set(eye, "display", "forward", "terms", 0, "orders", [0, 0, 0])), ("model.json", "orders|terms")),
    "a box of nan": (_eye(lambda eye: _set(eye, "display", "forward", "low", [np.nan] * 4)), ("model.json", "low|NaN")),
    "a box of 1e308": (_eye(lambda eye: _set(eye, "display", "forward", "high", [1e308] * 4)), ("model.json",)),
    "a panel of -5 pixels": (_eye(lambda eye: _set(eye, "display", "panel", "height_px", -5)), ("model.json", "height_px|panel")),
    "an eye box of nan": (_eye(lambda eye: _set(eye, "eye_box", "centre_m", [np.nan, 0, 0])), ("model.json", "centre_m|NaN")),
    "a base plane of nan": (_eye(lambda eye: _set(eye, "display", "base_plane", "z_m", np.nan)), ("model.json", "z_m|base_plane|NaN")),
    "a kind that is a list": (_eye(lambda eye: _set(eye, "display", "kind", ["planar"])), ("model.json", "kind")),
    "an unknown eye": (_eye(lambda eye: _set(eye, "eye", "third")), ("model.json", "eye")),
    "the left eye only": (_eye(lambda eye: _set(eye, "eye", "left")), ("model.json", "right")),
    "a million eyes": (_json(lambda model: _set(model, "eyes", [{}] * 1_000_000)), ("model.json",)),
    "eyes are a number": (_json(lambda model: _set(model, "eyes", 7)), ("model.json", "eyes")),
    "version nan": (_json(lambda model: _set(model, "version", np.nan)), ("model.json", "version|NaN")),
    "units of millimetres": (_json(lambda model: _set(model, "units", "length", "mm")), ("model.json", "units")),
    "a spread of other shape": (_eye(lambda eye: _set(eye, "display", "spread", "apart", "values", [[1, 2]])), ("model.json", "values|apart|spread")),
    "a spread of nan": (_eye(lambda eye: _set(eye, "display", "spread", "apart", "unit", [np.nan])), ("model.json", "unit|apart|spread|NaN")),
    "a spread of 1e9 shared": (_eye(lambda eye: _set(eye, "display", "spread", "shared", 10**9)), ("model.json", "shared|spread")),
    "is a number": (edited("model.json", lambda _: b"1e400"), ("model.json",)),
    "keys twice": (edited("model.json", lambda content: content.replace(b'"format"', b'"frame": "opencv", "format"', 1)), ("model.json", "frame")),
    "nested objects": (edited("model.json", lambda _: b'{"a":' * 50_000 + b"1" + b"}" * 50_000), ("model.json",)),
    "a number of a million digits": (edited("model.json", lambda _: b'{"version": ' + b"9" * 1_000_000 + b"}"), ("model.json",)),
}  # fmt: skip


def _arrays(change: Callable[[dict[str, Any]], object]) -> Change:
    def edit(content: bytes) -> bytes:
        with np.load(io.BytesIO(content)) as stored:
            arrays = dict(stored)
        change(arrays)
        written = io.BytesIO()
        np.savez(written, allow_pickle=True, **arrays)
        return written.getvalue()

    return edited("captures.npz", edit)


def _header(*keys_and_value: Any) -> Change:
    def change(arrays: dict[str, Any]) -> None:
        header = json.loads(str(arrays["header"]))
        _set(header, *keys_and_value)
        arrays["header"] = np.array(json.dumps(header))

    return _arrays(change)


def _column(name: str, make: Callable[[Any], Any]) -> Change:
    return _arrays(lambda arrays: _set(arrays, name, make(arrays[name])))


def _one(value: float) -> Callable[[Any], Any]:
    """One value of a column is replaced."""

    def make(column: Any) -> Any:
        changed = column.astype(np.float64)
        changed.flat[0] = value
        return changed

    return make


def _promise(folder: Path) -> None:
    """A column whose header states more numbers than there are."""
    with zipfile.ZipFile(folder / "captures.npz", "w") as archive, archive.open("viewpoint.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)})
        file.write(bytes(80))


CAPTURES: dict[str, tuple[Change, tuple[str, ...]]] = {
    "a header that promises 1e15 numbers": (_promise, ("captures.npz",)),
    "viewpoints in millimetres": (_column("viewpoint", lambda v: 1000 * v), ("captures.npz", "viewpoint")),
    "everything in millimetres": (
        _arrays(lambda a: a.update({k: 1000 * a[k] for k in ("viewpoint", "target_point")})),
        ("captures.npz",),
    ),
    "a viewpoint of 1e308": (_column("viewpoint", _one(1e308)), ("captures.npz", "viewpoint")),
    "sigmas of zero": (_column("sigma_arcmin", np.zeros_like), ()),
    "a capture of 1e18": (_column("capture", lambda c: c + 10**18), ("captures.npz", "capture")),
    "a capture of -5": (_column("capture", lambda c: c - 5), ("captures.npz", "capture")),
    "no rows": (
        _arrays(lambda a: a.update({k: v[:0] for k, v in a.items() if v.ndim})),
        ("captures.npz",),
    ),
    "a header that is a number": (_column("header", lambda _: np.array(5)), ("captures.npz", "header")),
    "units of millimetres": (_header("units", "length", "mm"), ("captures.npz", "units|length")),
    "a panel of -5 pixels": (_header("panel", "width_px", -5), ("captures.npz", "width_px|panel")),
    "a panel of text": (_header("panel", "width_px", "many"), ("captures.npz", "width_px")),
    "an eye box of nan": (_header("eye_box", "centre_m", [np.nan, 0, 0]), ("captures.npz", "centre_m")),
    "a device of escapes": (_header("device", "a\x1b[31m\nforged"), ()),
    "a device that is a path": (_header("device", "../../x"), ()),
    "a device that is a list": (_header("device", ["x"]), ("captures.npz", "device")),
}


def cases() -> Iterator[Case]:
    for title, (change, names) in MODELS.items():
        yield Case(f"model: {title}", RENDER, FILES, change, names)
    for title, (change, names) in CAPTURES.items():
        yield Case(f"captures: {title}", FIT, ("captures.npz",), change, names, "refused" if names else "any")
    for title in ("viewpoints in millimetres", "a viewpoint of 1e308", "a device that is a path", "no rows"):
        change, names = CAPTURES[title]
        yield Case(
            f"captures diagnosed: {title}", DIAGNOSE, ("captures.npz",), change, names, "refused" if names else "any"
        )
