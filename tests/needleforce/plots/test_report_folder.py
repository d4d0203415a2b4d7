"""The folder of a report: whole or not at all, and nothing else is touched."""

import os
from pathlib import Path

import pytest

from needleforce.plots import ChartError, WriteError, whole_folder
from needleforce.plots import report_folder as module

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


def test_a_new_report_appears_at_the_end_with_its_parents(tmp_path):
    folder = tmp_path / "a" / "b"
    with whole_folder(folder) as place:
        (place / "index.html").write_text("page")
        assert not folder.exists()

    assert content(tmp_path) == {"a/b/index.html": "page"}
    assert os.listdir(tmp_path / "a") == ["b"]


FAILURES = [
    ChartError("it cannot be drawn"),
    OSError(28, "No space left on device"),
    KeyboardInterrupt(),
]


@pytest.mark.parametrize("failure", FAILURES, ids=repr)
def test_an_error_or_an_interrupt_leaves_no_folder(tmp_path, failure):
    with pytest.raises(type(failure)):
        write_report(tmp_path / "a" / "b", failure)

    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("failure", FAILURES, ids=repr)
def test_an_error_or_an_interrupt_leaves_an_older_report_as_it_was(tmp_path, failure):
    write_report(tmp_path)
    (tmp_path / "index.html").write_text("older")
    (tmp_path / "notes.txt").write_text("mine")
    before = content(tmp_path)

    with pytest.raises(type(failure)):
        write_report(tmp_path, failure)

    assert content(tmp_path) == before
    assert len(os.listdir(tmp_path)) == 3


def test_a_report_replaces_an_older_one_and_keeps_other_files(tmp_path):
    (tmp_path / "index.html").write_text("older")
    (tmp_path / "notes.txt").write_text("mine")
    write_report(tmp_path)

    assert content(tmp_path) == {**REPORT, "notes.txt": "mine"}


@pytest.mark.parametrize("failure", [OSError(5, "I/O error"), KeyboardInterrupt()])
@pytest.mark.parametrize("fatal_rename", range(4))
def test_a_failure_while_files_are_moved_undoes_the_moves(
    tmp_path, monkeypatch, failure, fatal_rename
):
    write_report(tmp_path)
    for name in REPORT:
        (tmp_path / name).write_text("older")
    rename = Path.rename
    calls = []

    def rename_or_fail(self, target):
        calls.append(target)
        if len(calls) == fatal_rename + 1:
            raise failure
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", rename_or_fail)
    with pytest.raises((WriteError, KeyboardInterrupt)):
        write_report(tmp_path)

    assert content(tmp_path) == dict.fromkeys(REPORT, "older")


def test_a_full_disk_at_the_rename_leaves_nothing(tmp_path, monkeypatch):
    def no_space(draft, folder):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "_publish", no_space)
    with pytest.raises(WriteError, match=r"cannot write to .*No space left on device"):
        write_report(tmp_path / "report")

    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_is_refused_before_the_work(tmp_path):
    (tmp_path / "file").touch()
    (tmp_path / "folder" / "index.html").mkdir(parents=True)
    for place, why in (
        ("file", "a file"),
        ("file/a", "cannot"),
        ("folder", "a folder"),
    ):
        with pytest.raises(WriteError, match=why), whole_folder(tmp_path / place):
            pytest.fail("the block was entered")

    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def test_no_report_yields_no_folder():
    with whole_folder(None) as place:
        assert place is None


def test_a_report_without_files_leaves_no_folder(tmp_path):
    with whole_folder(tmp_path / "a" / "b"):
        pass

    assert list(tmp_path.iterdir()) == []
