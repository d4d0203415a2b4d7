"""Which forces of `python -m residual` the identification does not take."""

import numpy as np
import pytest

import needleforce.cli.identify as command
from groundtruth import insert_needle
from needleforce import session
from needleforce.cli.identify_report import ForceStatus
from recordings import write_table
from recordings.columns.force_codes import FORCE_STATUS, WORTHLESS
from recordings.log_stream import LogChunk
from residual import SensorWarning, Status


def test_the_codes_are_those_of_the_virtual_sensor():
    assert tuple(status.value for status in Status) == FORCE_STATUS
    for word, bit in WORTHLESS.items():
        assert SensorWarning[word.upper().replace(" ", "_")] == bit


def test_the_command_leaves_out_the_cautions_that_a_session_leaves_out():
    assert sum(WORTHLESS.values()) == session._NOT_FED


@pytest.mark.parametrize("name", ["force_status", "force_warnings", "both"])
def test_marked_rows_are_left_out_and_counted(name):
    status = np.array([0.0, 1.0, 2.0, 3.0, 0.0, 0.0])
    warnings = np.array([0.0, 0.0, 0.0, 0.0, 5.0, 32.0 + 1.0])
    columns = {"force_status": status, "force_warnings": warnings}
    chosen = columns if name == "both" else {name: columns[name]}
    reader = ForceStatus(is_ignored=False)
    force_N = reader.force_N(_chunk(chosen))
    is_marked = (status != 0) & ("force_status" in chosen)
    bad = is_marked | ((warnings == 33) & ("force_warnings" in chosen))
    np.testing.assert_array_equal(np.isnan(force_N), bad)
    assert len(reader.warnings) == (2 if name == "both" else 1)
    assert not np.isnan(ForceStatus(is_ignored=True).force_N(_chunk(chosen))).any()


def test_a_status_column_of_the_user_does_not_silence_a_log(tmp_path, capsys):
    run = insert_needle("gel-50-constant", seed=1, rate_hz=150.0)
    columns = {"t_s": run.t_s, "depth_m": run.depth_m, "force_N": run.force_N}
    log = tmp_path / "log.csv"
    write_table(log, columns | {"status": np.ones(len(run.t_s))})
    assert command.main([str(log)]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2
    write_table(log, columns | {"force_warnings": np.full(len(run.t_s), 32)})
    assert command.main([str(log)]) == 0
    told = capsys.readouterr()
    assert f"velocity) were left out: {len(run.t_s)}" in told.err
    assert "no layer was left" in told.out


def _chunk(columns):
    rows = np.arange(6.0)
    return LogChunk(t_s=rows, dt_s=rows, channels={"force_N": rows + 1.0} | columns)
