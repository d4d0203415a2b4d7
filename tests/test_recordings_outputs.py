"""What a command writes never harms its log, its other outputs or what is not its own."""

from argparse import ArgumentParser

import numpy as np
import pytest

from recordings import FileAccessError, check_writable, write_table
from recordings.command.output_arguments import check_outputs, output_arguments
from recordings.command.source_arguments import source_arguments

COLUMNS = {"t_s": np.arange(3) / 1000.0, "force_N": np.ones(3)}


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_table("log.csv", COLUMNS)
    write_table("bag.db3", COLUMNS)


def check(*argv):
    parser = ArgumentParser()
    source_arguments(parser, "time")
    output_arguments(parser, table="t", picture="p", page="q")
    return check_outputs(parser.parse_args(argv))


@pytest.mark.parametrize(
    ("source", "output"),
    [
        ("bag.db3", "bag.db3/x.db3"),
        ("bag.db3", "bag.db3/x.csv"),
        ("bag.db3/bag.db3", "bag.db3"),
        ("bag.db3/bag.db3", "bag.db3/other.mcap"),
        ("bag.db3", "bag.db3"),
        ("link", "bag.db3/x.csv"),
    ],
)
def test_a_table_is_never_written_into_or_over_the_bag_that_is_read(tmp_path, source, output):
    (tmp_path / "link").symlink_to(tmp_path / "bag.db3")
    with pytest.raises(FileAccessError, match="the log"):
        check(source, "-o", output)
    with pytest.raises(FileAccessError, match="the log"):
        check_writable(output, source=source)


def test_neither_picture_nor_report_is_written_into_the_log(tmp_path):
    for option in (["--png", "bag.db3/x.png"], ["--report", "bag.db3"], ["--report", "bag.db3/r"]):
        with pytest.raises(FileAccessError, match="the log"):
            check("bag.db3", *option)
    (tmp_path / "log.png").symlink_to(tmp_path / "log.csv")
    with pytest.raises(FileAccessError, match="it is the log itself"):
        check("log.csv", "--png", "log.png")


@pytest.mark.parametrize("name", ["log.csv", "picture.gif", "picture", "no/where.png"])
def test_a_picture_is_a_png_in_a_folder_that_is_there(name):
    with pytest.raises(FileAccessError, match=f"cannot write {name}"):
        check("other.csv", "--png", name)


def test_outputs_do_not_replace_each_other(tmp_path):
    (tmp_path / "f.csv").touch()
    (tmp_path / "f.png").symlink_to(tmp_path / "f.csv")
    for argv in (
        ["-o", "f.csv", "--png", "f.png"],
        ["-o", "out.db3", "--png", "out.db3"],
        ["-o", "new.csv", "--report", "new.csv"],
        ["-o", "out.db3", "--report", "out.db3"],
    ):
        with pytest.raises(FileAccessError, match=r"both write to|must end in \.png"):
            check("log.csv", *argv)


def test_outputs_side_by_side_are_fine():
    for argv in (
        ["log.csv", "-o", "f.csv", "--png", "f.png", "--report", "."],
        ["bag.db3", "-o", "f.db3", "--png", "f.png", "--report", "report"],
        ["log.csv", "-o", "bag.db3"],
        ["-", "-o", "-", "--png", "f.png"],
    ):
        assert check(*argv) is None


def test_only_a_bag_and_nothing_else_is_replaced_by_a_bag(tmp_path):
    write_table("bag.db3", COLUMNS)
    notes = tmp_path / "bag.db3" / "notes.txt"
    notes.write_text("dear")
    (tmp_path / "file.db3").write_text("dear")
    (tmp_path / "empty.db3").mkdir()
    for name, told in (
        ("bag.db3", "'notes.txt', which is no part of a bag"),
        ("file.db3", "a file of this name"),
        ("empty.db3", "it is no bag"),
    ):
        with pytest.raises(FileAccessError, match=told):
            check_writable(name)
        with pytest.raises(FileAccessError, match=told):
            write_table(name, COLUMNS)
    assert notes.read_text() == (tmp_path / "file.db3").read_text() == "dear"


def test_a_folder_is_no_place_for_a_file(tmp_path):
    (tmp_path / "t.csv").mkdir()
    with pytest.raises(FileAccessError, match="it is a folder"):
        check_writable("t.csv")
