"""Keys and values of YAML and JSON files of other programs."""

import json
from pathlib import Path
from typing import Any

import yaml

from wlr_render.errors import BadInputError
from wlr_render.io.input_files import as_bad_input

_OPENCV_DIRECTIVE = "%YAML:"  # OpenCV's first line up to version 4, which YAML does not allow


def read_mapping(file: Path, text: str, kind: str, remedy: str) -> dict[str, Any]:
    """Return the keys and values of a YAML or JSON text; of several YAML documents, the first non-empty one.

    Args:
        file: path of the file, for errors.
        text: text of the file.
        kind: expected content, e.g. "a file of a lens".
        remedy: remedy, without a full stop.

    Raises:
        BadInputError: the text is neither YAML nor JSON, or holds no keys; the message has the line.
    """
    text = text.lstrip()
    if text.startswith(_OPENCV_DIRECTIVE):
        text = text.partition("\n")[2]
    if text.startswith("{"):
        with as_bad_input(file, f"JSON, as {kind}", remedy):
            content = json.loads(text)
    else:
        with as_bad_input(file, f"YAML, as {kind}", remedy):
            content = _first_document(text)
    if not isinstance(content, dict):
        raise BadInputError(f"{file}: has no keys with values, so this is not {kind}; {remedy}.")
    return {str(key): value for key, value in content.items()}


def _first_document(text: str) -> Any:
    """Return the first non-empty YAML document of a text, or None."""
    try:
        return next((document for document in yaml.safe_load_all(text) if document is not None), None)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ValueError(f"{line}{error.problem}") from error
    except AttributeError as error:  # raised by PyYAML for a value that does not match its tag
        raise ValueError("a value is not of its tag's type") from error
