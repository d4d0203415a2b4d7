"""The demonstration from a CT to the target: what it prints and writes."""

import re

import numpy as np
import pytest

from needleforce.anatomy import RegistrationError
from needleforce.cli import main
from needleforce.simulation import planned_insertion, scanned_torso

pytestmark = pytest.mark.slow


pytest.importorskip("skimage")


def test_ruptures_bring_the_tip_to_its_target(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(planned_insertion, "SPEED_m_s", 6e-3)

    assert main(["demo", "abdomen", "--seed", "1", "--report", str(tmp_path)]) == 0

    said = capsys.readouterr().out

    assert "not a medical device" in said

    shift = float(re.search(r"true shift along the needle +([-+]\d+\.\d) mm", said)[1])
    off = re.search(r"plan off by +(\d+\.\d) -> (\d+\.\d) mm after (\d) rup", said)
    by_plan = float(off[1])
    corrected = float(off[2])

    assert re.search(r"^CT +analytic torso.* voxels of 2, 2, 2 mm$", said, re.MULTILINE)
    assert re.search(r"planned path .*lesion \d+ mm; target in the lesion\n", said)
    assert len(re.findall(r"^rupture \d", said, re.MULTILINE)) == int(off[3])
    assert by_plan == pytest.approx(abs(shift), abs=1.0)
    assert corrected < 1.5
    assert re.search(r"rupture 1 at .* into \w+ \(\d+ %\)", said)

    pytest.importorskip("viser")

    assert (tmp_path / "scene.html").stat().st_size > 100_000


@pytest.mark.parametrize("seed", [0, 1])
def test_a_planned_way_crosses_soft_tissue_only(seed):
    rng = np.random.default_rng(seed)
    torso = scanned_torso.read_torso(None, rng)
    labels = torso.labels
    entry, target, thick = scanned_torso.plan_path(labels, torso.target, rng)
    layers = labels.layers_along(entry, target)

    assert layers[-1].name == "lesion"
    assert {layer.name for layer in layers} <= {*scanned_torso.CROSSABLE}

    assert min(layer.exit_m - layer.entry_m for layer in thick) >= 6.5e-3


def test_a_torso_whose_first_landmarks_lie_symmetrically_is_registered(monkeypatch):
    def refuse(*_args, **_settings):
        raise RegistrationError("not looked at here")

    monkeypatch.setattr(planned_insertion.anatomy, "fit_surface", refuse)
    rng = np.random.default_rng(1011)
    torso = scanned_torso.read_torso(None, rng)
    path = scanned_torso.plan_path(torso.labels, torso.target, rng)
    placement = planned_insertion._draw_placement(rng)
    found = planned_insertion.register(torso.labels, path.entry_m, placement, rng)

    error_m = found.fine.to_robot(path.target_m) - placement.to_robot(path.target_m)
    assert np.linalg.norm(error_m) < 3e-3
