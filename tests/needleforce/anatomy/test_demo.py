"""The demonstration from a CT to the target: what it prints and writes."""

import re

import pytest

from needleforce.cli import main

pytestmark = pytest.mark.slow


def test_ruptures_bring_the_tip_to_its_target(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("needleforce.simulation.patient.SPEED_m_s", 10e-3)
    monkeypatch.setattr(
        "needleforce.simulation.torso_case.SPACING_m", (4e-3, 4e-3, 5e-3)
    )

    assert main(["demo", "abdomen", "--seed", "1", "--report", str(tmp_path)]) == 0

    said = capsys.readouterr().out
    shift = float(re.search(r"true shift along the needle +([-+]\d+\.\d) mm", said)[1])
    off = re.search(r"plan off by +(\d+\.\d) -> (\d+\.\d) mm after (\d) rup", said)

    for pattern in (
        "not a medical device",
        r"CT +analytic torso.* voxels of .* mm\n",
        r"planned path .*lesion \d+ mm; target in the lesion\n",
        r"rupture 1 at .* into \w+ \(\d+ %\)",
    ):
        assert re.search(pattern, said)
    assert len(re.findall(r"^rupture \d", said, re.MULTILINE)) == int(off[3])
    assert float(off[1]) == pytest.approx(abs(shift), abs=1.0)
    assert float(off[2]) < 1.5
    assert (tmp_path / "scene.html").stat().st_size > 100_000
