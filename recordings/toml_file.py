"""Reading the small TOML files that options name."""

import tomllib
from pathlib import Path
from typing import Any

from recordings.errors import FileAccessError, FormatError


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """Return the content of a TOML file.

    Args:
        path: the file.
        what: what it is, for messages, such as `payload file`.

    Returns:
        Its tables and keys; at least one.

    Raises:
        FileAccessError: it cannot be read.
        FormatError: it is not TOML, or is empty.
    """
    try:
        content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        reason = error.strerror or error
        raise FileAccessError(f"cannot read the {what} {path}: {reason}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FormatError(f"the {what} {path} is not valid TOML: {error}") from error
    if not content:
        raise FormatError(f"the {what} {path} is empty")
    return content
