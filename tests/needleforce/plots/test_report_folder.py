"""The folder of a report: whole or not at all, and nothing else is touched."""

import os

import pytest

from needleforce.plots import ChartError, WriteError, whole_folder

REPORT = {"figure.svg": "drawn", "index.html": "page"}


def content(folder):
    """Names and texts of the files below a folder."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_text() for path in files}


def write_report(folder, failure=None):
    with whole_folder(folder) as place:
        for name, text in REPORT.items():
            (place / name).write_text(text)
            if failure is not None:
                raise failure
        assert not (folder / "figure.svg").exists()


def test_a_new_report_appears_at_the_end_with_its_parents(tmp_path):
    folder = tmp_path / "a" / "b"
    write_report(folder)

    assert content(tmp_path / "a") == {f"b/{name}": REPORT[name] for name in REPORT}
    assert sorted(os.listdir(folder)) == sorted(REPORT)


@pytest.mark.parametrize(
    "failure",
    [ChartError("it cannot be drawn"), OSError(28, "No space"), KeyboardInterrupt()],
    ids=repr,
)
@pytest.mark.parametrize("older", [{}, {"index.html": "older", "notes.txt": "mine"}])
def test_an_error_or_an_interrupt_changes_nothing(tmp_path, failure, older):
    folder = tmp_path / "report"
    for name, text in older.items():
        folder.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    with pytest.raises(type(failure)):
        write_report(folder, failure)

    assert content(tmp_path) == {f"report/{name}": older[name] for name in older}
    assert folder.exists() == bool(older)


def test_a_report_replaces_an_older_one_and_keeps_other_files(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "index.html").write_text("older")
    write_report(tmp_path)

    assert content(tmp_path) == {**REPORT, "notes.txt": "mine"}


@pytest.mark.parametrize("place", ["file", "file/a"])
def test_a_place_that_cannot_be_is_refused_before_the_work(tmp_path, place):
    (tmp_path / "file").touch()
    with pytest.raises(WriteError, match="file"), whole_folder(tmp_path / place):
        pytest.fail("the block was entered")

    assert os.listdir(tmp_path) == ["file"]


def test_no_report_yields_no_folder():
    with whole_folder(None) as place:
        assert place is None
