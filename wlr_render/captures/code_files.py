"""Files of a set of code photographs: the picture that each shows, and its exposures."""

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wlr_render.captures.patterns.light_gains import LightGains, light_gains
from wlr_render.captures.photo_session import CODE_ORDERS
from wlr_render.captures.photograph_format import PhotographFormat
from wlr_render.captures.photographs import SUFFIXES, CodeImage, exposure_of, photographs_in, read_each, read_photograph
from wlr_render.errors import BadInputError
from wlr_render.io.input_files import inside_folder
from wlr_render.io.toml_files import read_toml

MANIFEST = "manifest.toml"
_AXES = {"u": "u", "x": "u", "column": "u", "columns": "u", "v": "v", "y": "v", "row": "v", "rows": "v"}
_ROLE = re.compile(r"[uv] (bit \d+( inverse)?|fringe .+ step \d+)")
"""Role of a picture of any code, other than white and black."""
_LONGEST_S = 10_000.0  # longest exposure time; a longer one is in another unit
_SAME_EXPOSURE = 1.02  # largest ratio of exposure times in one set; cameras round the time that they report
_SECONDS = {"us": 1e-6, "ms": 1e-3, "s": 1.0}


@dataclass(frozen=True)
class CodeFiles:
    """Files of one set, in the order in which its pictures are shown.

    Attributes:
        pictures: files of each picture, one per exposure; empty if the picture is missing.
        exposures_s: exposure time of each; empty for a single exposure.
        names: names of the pictures.
        taken: position of each picture in the order of taking; -1 for a missing one. Empty without `whites`.
        whites: further photographs of white, each with its position in this order.
    """

    pictures: tuple[tuple[Path, ...], ...]
    exposures_s: tuple[float, ...] = ()
    names: tuple[str, ...] = ()
    taken: tuple[int, ...] = ()
    whites: tuple[tuple[int, Path], ...] = ()
    _light: dict[PhotographFormat, LightGains] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def with_whites(
        cls, pictures: Sequence[tuple[Path, ...]], names: Sequence[str], order: Sequence[Path], whites: Sequence[Path]
    ) -> "CodeFiles":
        """Return a set of single exposures with further photographs of white; `order` lists its files as taken."""
        if not whites:
            return cls(tuple(pictures))
        place = {path: number for number, path in enumerate(order)}
        taken = tuple(place[files[0]] if files else -1 for files in pictures)
        return cls(tuple(pictures), (), tuple(names), taken, tuple((place[path], path) for path in whites))

    @property
    def paths(self) -> list[Path]:
        """All files."""
        return [path for files in self.pictures for path in files] + [path for _, path in self.whites]

    @property
    def missing(self) -> list[int]:
        """Numbers of the pictures without a photograph."""
        return [number for number, files in enumerate(self.pictures) if not files]

    def end_of_scale(self, kind: PhotographFormat) -> float:
        """Return the value from which a pixel of `read` is saturated."""
        return kind.end_of_scale * (max(self.exposures_s) / min(self.exposures_s) if self.exposures_s else 1.0)

    def light(self, kind: PhotographFormat) -> LightGains | None:
        """Return the gains of the pictures, reading all of them; None without further photographs of white.

        Raises:
            BadInputError: as `read_photograph` and `light_gains`.
        """
        if not self.whites:
            return None
        if kind in self._light:
            return self._light[kind]
        places, paths = zip(*self.whites, strict=True)
        whites = (read_photograph(path, kind) for path in paths)
        taken = np.array(self.taken), np.array(places)
        self._light[kind] = light_gains(self._single(kind), whites, self.names, *taken, self.end_of_scale(kind))
        return self._light[kind]

    def _single(self, kind: PhotographFormat) -> Iterator[CodeImage | None]:
        """Read the pictures of a set of one exposure."""
        photographs = read_each([files[0] for files in self.pictures if files], kind)
        for files in self.pictures:
            yield next(photographs) if files else None

    def read(self, kind: PhotographFormat) -> Iterator[CodeImage | None]:
        """Read the pictures one at a time; None for a missing one.

        Several exposures are merged to float32 values on the scale of the longest. Each pixel uses the exposures that
        do not saturate it in the first picture, white, weighted by their time; because they are the same in the whole
        set, a black level has no effect on differences of pictures.

        With further photographs of white, the pictures are scaled to equal light (`light_gains`) as float32 values.

        Raises:
            BadInputError: as `read_photograph`; or white is missing from a set of several exposures.
        """
        if not self.exposures_s:
            gains = self.light(kind)
            for number, image in enumerate(self._single(kind)):
                yield image if gains is None or image is None else gains.repaired(number, image)
            return
        if not self.pictures[0]:
            folder = next(files[0].parent for files in self.pictures if files)
            raise BadInputError(
                f"{folder}: the first picture, white, is missing, without which several exposures cannot "
                "be merged; photograph it."
            )
        weights: NDArray[np.float32] | None = None
        time = np.array(self.exposures_s, dtype=np.float32)
        for files in self.pictures:
            if not files:
                yield None
                continue
            images = [read_photograph(path, kind) for path in files]
            if len({(image.shape, image.dtype) for image in images}) > 1:
                raise BadInputError(
                    f"{files[0]}: the exposures of this picture differ in size or depth; take them again."
                )
            if weights is None:
                unsaturated = np.array([image < kind.end_of_scale for image in images])
                weights = unsaturated * time[:, None, None]
                weights /= np.maximum(weights.sum(axis=0), time.min())
            light = np.zeros(images[0].shape, dtype=np.float32)
            over = ~weights.any(axis=0)
            for image, weight, seconds in zip(images, weights, time, strict=True):
                light += weight * image * (time.max() / seconds)
                over |= (weight > 0) & (image >= kind.end_of_scale)
            light[over] = np.float32(self.end_of_scale(kind))
            yield light


def find_code_files(
    folder: Path, names: Sequence[str], order: str = CODE_ORDERS[0], manifest: Path | None = None
) -> CodeFiles:
    """Find the picture that each photograph of a folder shows.

    The criteria are, in this order: a manifest; names of `wlr-render pattern` (000_white.png); the numbers in the
    names, if the first and last are there; the order of the names, without a gap. Subfolders hold one exposure each.

    Args:
        folder: folder of the set.
        names: names of the pattern's pictures in the order of showing.
        order: one of `CODE_ORDERS`, for files whose roles are not named: white and black first, or last as in OpenCV's
            `GrayCodePattern`.
        manifest: file that names the roles; None: manifest.toml in the folder, if there is one.

    Raises:
        BadInputError: photographs are missing or left over, a role is unknown or given twice, or an exposure time is
            unknown; the message names the file and the remedy.
    """
    stated: dict[str, float] = {}
    if manifest is not None or (folder / MANIFEST).is_file():
        manifest = manifest or folder / MANIFEST
        order, roles, stated = _read_manifest(manifest, order)
        if roles:
            return _by_manifest(manifest, folder, roles, stated, names)
    below = _exposure_folders(folder)
    if below:
        times = [_exposure_time(each, stated) for each in below]
        sets = [_by_name(photographs_in(each), names, order, each) for each in below]
        return CodeFiles(
            tuple(tuple(path for (path,) in files) if all(files) else () for files in zip(*sets, strict=True)),
            tuple(times),
        )
    paths = photographs_in(folder)
    _check_one_exposure(paths)
    whites = [path for path in paths if _stated(path) == names[0] and re.match(r"\d", path.stem)][1:]
    pictures = _by_name([path for path in paths if path not in whites], names, order, folder)
    return CodeFiles.with_whites(pictures, names, paths, whites)


def _read_manifest(path: Path, order: str) -> tuple[str, dict[str, str], dict[str, float]]:
    """Return the order of showing, role by file name, and exposure time in seconds by file or folder name."""
    table = read_toml(path)
    order = table.text("order", order, choices=CODE_ORDERS)
    roles, times = table.raw_table("files"), table.raw_table("exposures_s")
    table.finish()
    if not all(isinstance(role, str) for role in roles.values()):
        raise table.fail('[files] must give each file name a role, such as "0.png" = "u bit 10".')
    if not all(type(time) in (int, float) and 0 < time <= _LONGEST_S for time in times.values()):
        raise table.fail(
            f"[exposures_s] must give each file or folder a time in seconds above 0, and at most {_LONGEST_S:g}; "
            "correct it."
        )
    return order, roles, {name: float(time) for name, time in times.items()}


def _by_manifest(
    manifest: Path, folder: Path, roles: dict[str, str], stated: dict[str, float], names: Sequence[str]
) -> CodeFiles:
    by_role: list[list[Path]] = [[] for _ in names]
    for file, role in roles.items():
        path = inside_folder(folder, file, str(manifest))
        if role.strip().lower() == "unused":
            continue
        number = _number_of_role(role, names)
        if number is None:
            raise BadInputError(
                f"{manifest}: {file} has the role '{role}'; the code has {', '.join(names[:3])}, ..., {names[-1]}, and "
                "'unused' is for other files."
            )
        if not os.path.isfile(path):  # unlike Path.is_file, False for a name that is too long
            raise BadInputError(f"{manifest}: there is no {path}; correct its name, or remove it from the manifest.")
        by_role[number].append(path)
    whites = by_role[0][1:] if max(map(len, by_role[1:])) == 1 else []
    if whites:
        by_role[0] = by_role[0][:1]
    counts = {len(files) for files in by_role if files}
    if len(counts) != 1:
        twice = next((n for n, files in enumerate(by_role) if len(files) > 1), 0)
        raise BadInputError(
            f"{manifest}: {len(by_role[twice])} files have the role '{names[twice]}', but others have another number; "
            "give each picture one file, or one of each exposure."
        )
    if counts == {1}:
        _check_one_exposure([path for files in [*by_role, whites] for path in files])
        order = [inside_folder(folder, file, str(manifest)) for file in roles]
        return CodeFiles.with_whites([tuple(files) for files in by_role], names, order, whites)
    timed = [
        sorted((_exposure_time(path, stated, str(path.relative_to(folder))), path) for path in files)
        for files in by_role
    ]
    times = {tuple(time for time, _ in files) for files in timed if files}
    if len(times) != 1:
        raise BadInputError(f"{manifest}: the pictures differ in their exposure times; give each the same ones.")
    return CodeFiles(tuple(tuple(path for _, path in files) for files in timed), times.pop())


def _number_of_role(role: str, names: Sequence[str]) -> int | None:
    plain = _plain_role(role)
    return names.index(plain) if plain in names else None


def _plain_role(role: str) -> str:
    """Return a role with the name that patterns use, e.g. "u bit 3" for "column_bit_3"."""
    words = role.lower().replace("_", " ").split()
    if words and words[0] in _AXES:
        words[0] = _AXES[words[0]]
    return " ".join(words)


def _by_name(paths: Sequence[Path], names: Sequence[str], order: str, folder: Path) -> tuple[tuple[Path, ...], ...]:
    """Return the files of each picture, identified by name or number."""
    files: list[tuple[Path, ...]] = [()] * len(names)
    stated = [_stated(path) for path in paths]
    roles = [_number_of_role(each, names) for each in stated]
    _check_code(paths, stated, roles)
    if None not in roles:
        for path, role in zip(paths, roles, strict=True):
            if role is None or files[role]:
                raise BadInputError(f"{path}: a second photograph shows '{names[role or 0]}'; remove one of them.")
            files[role] = (path,)
        return tuple(files)
    shown = [*range(2, len(names)), 0, 1] if order == "opencv" else range(len(names))
    places = range(len(paths)) if len(paths) == len(names) else _numbered_places(paths, len(names))
    if not places:
        raise BadInputError(
            f"{folder}: holds {len(paths)} photographs, but the code has {len(names)} pictures; give one photograph a "
            f"picture, or name their pictures in {MANIFEST}."
        )
    for path, place in zip(paths, places, strict=True):
        files[shown[place]] = (path,)
    return tuple(files)


def _stated(path: Path) -> str:
    """Return a file's stem without its leading number."""
    return re.sub(r"^\d+[_ -]", "", path.stem)


def _check_code(paths: Sequence[Path], stated: Sequence[str], roles: Sequence[int | None]) -> None:
    """Refuse names that state pictures of another code, or only some pictures of this code.

    Args:
        paths: paths of the photographs.
        stated: text of each name, without its number.
        roles: picture of the code for each name; None without one.

    Raises:
        BadInputError: the message names the first such photograph.
    """
    plain = [_plain_role(each) for each in stated]
    foreign = [n for n, each in enumerate(plain) if roles[n] is None and _ROLE.fullmatch(each)]
    if foreign:
        bits, fringes = (any(f" {kind} " in each for each in plain) for kind in ("bit", "fringe"))
        code = "gray-fringes" if bits and fringes else "gray" if bits else "fringes"
        raise BadInputError(
            f"{paths[foreign[0]]}: shows '{plain[foreign[0]]}', which is not a picture of this code; the names "
            f"belong to the code {code}: choose it as pattern, with the size of the panel that showed it."
        )
    unnamed = [path for path, role in zip(paths, roles, strict=True) if role is None]
    if unnamed and len(unnamed) < len(paths):
        raise BadInputError(
            f"{unnamed[0]}: its name states no picture of the code, unlike other names in its folder; "
            f"remove it, or name all pictures in {MANIFEST}."
        )


def _numbered_places(paths: Sequence[Path], count: int) -> Sequence[int]:
    """Return positions in the set from the last number in each name; empty unless the first and last are there."""
    numbers = [re.findall(r"\d+", path.stem) for path in paths]
    if not all(numbers):
        return []
    places = [int(each[-1]) - int(numbers[0][-1]) for each in numbers]
    return places if places[-1] == count - 1 and len(set(places)) == len(places) else []


def _exposure_folders(folder: Path) -> list[Path]:
    """Return the subfolders with photographs, sorted by name; none if the folder itself has photographs."""
    if not folder.is_dir() or any(path.suffix.lower() in SUFFIXES for path in folder.iterdir()):
        return []
    return sorted(
        path
        for path in folder.iterdir()
        if path.is_dir() and any(each.suffix.lower() in SUFFIXES for each in path.iterdir())
    )


def _exposure_time(path: Path, stated: dict[str, float], name: str = "") -> float:
    """Return the exposure time in seconds, from the manifest, the files, or the name of a folder."""
    if (name or path.name) in stated:
        return stated[name or path.name]
    in_file = exposure_of(path if path.is_file() else photographs_in(path)[0])
    if in_file is not None:
        return in_file
    match = re.fullmatch(r"(\d+\.?\d*) *(us|ms|s)", path.name)
    if match:
        return float(match[1]) * _SECONDS[match[2]]
    raise BadInputError(
        f"{path}: its exposure time is unknown; state it in {MANIFEST} under [exposures_s], or name the folder "
        "after it, such as 4ms."
    )


def _check_one_exposure(paths: Sequence[Path]) -> None:
    """Refuse a set whose files state different exposure times.

    Raises:
        BadInputError: two files state different times.
    """
    times = [(time, path) for path in paths if (time := exposure_of(path)) is not None]
    if times and max(times)[0] > _SAME_EXPOSURE * min(times)[0]:
        (short, one), (long, other) = min(times), max(times)
        raise BadInputError(
            f"{one}: was exposed {short:g} s, {other.name} {long:g} s; all photographs of a set need one exposure: "
            "switch automatic exposure off."
        )
