"""The files of the project."""

import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
INSTALLED = (
    "foundation",
    "urdf",
    "residual",
    "identification",
    "groundtruth",
    "needleforce",
)
PACKAGES = (*INSTALLED, "benchmarks")


def listed_by_git():
    """Names of the files under version control; none in a copy without it."""
    try:
        listed = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return []
    return [name for name in listed.stdout.decode().split("\0") if name]


def project_files():
    """Files under version control; in a copy without it, what lies in the project's
    folders."""
    paths = [ROOT / name for name in listed_by_git()]
    if not paths:
        folders = (*PACKAGES, ".ci", "tests", "docs", "examples")
        paths = [path for folder in folders for path in (ROOT / folder).rglob("*")]
        paths += [path for path in ROOT.glob("*.*") if not path.name.startswith(".")]
    return [
        path for path in paths if path.is_file() and "__pycache__" not in path.parts
    ]


def text_files():
    """Every file that is text, with its content."""
    for path in project_files():
        try:
            yield path, path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue


def name_of(path):
    return str(path.relative_to(ROOT))


PACKAGE_SOURCES = [
    path
    for path in project_files()
    if path.suffix == ".py" and path.relative_to(ROOT).parts[0] in PACKAGES
]
