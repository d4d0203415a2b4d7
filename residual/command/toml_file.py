"""Reading the small TOML files that options name."""

import tomllib
from pathlib import Path
from typing import Any

from residual.command.errors import CommandError


def read_toml(path: str, what: str) -> dict[str, Any]:
    """Return the content of a TOML file.

    Args:
        path: The file.
        what: What it describes, for messages.

    Raises:
        CommandError: It cannot be read, is not TOML, or is empty.
    """
    try:
        content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        reason = error.strerror or error
        raise CommandError(f"cannot read the {what} file {path}: {reason}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CommandError(f"the {what} file {path} is not valid TOML: {error}") from error
    if not content:
        raise CommandError(f"the {what} file {path} is empty; see docs/residual.md")
    return content
