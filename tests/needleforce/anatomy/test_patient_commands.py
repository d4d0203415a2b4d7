"""From a CT to a registered plan, by commands alone."""

import json
import os
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from needleforce.anatomy.markups import read_markup
from needleforce.cli import main
from needleforce.plan_file import read_plan

pytestmark = pytest.mark.slow


SCRIPT = Path(__file__).parents[3] / "examples" / "ct_to_insertion.sh"


def commands():
    """The commands of the example, but for the last, which runs for a minute."""
    lines = SCRIPT.read_text(encoding="utf-8").splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith("needleforce")]


COARSE_m = (4e-3, 4e-3, 5e-3)
"""Voxels of the torso here: a quarter of the usual number."""

QUICK_m_s = 10e-3
"""Speed of the insertion here: two fifths of its usual time."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the example was run on a coarse CT, up to the insertion."""
    pytest.importorskip("SimpleITK")
    pytest.importorskip("matplotlib")
    place = tmp_path_factory.mktemp("patient")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setattr("needleforce.simulation.torso_case.SPACING_m", COARSE_m)
        patch.setattr("needleforce.cli.patient.plan_page.find_spec", lambda name: None)
        for arguments in commands()[:-1]:
            assert main(arguments) == 0
    return place


def test_the_example_is_twelve_lines_of_shell():
    assert len(commands()) == 5
    assert len(SCRIPT.read_text(encoding="utf-8").splitlines()) <= 12


def test_the_registered_plan_lies_where_the_patient_is(folder):
    plan = read_plan(folder / "plan" / "plan.json")
    markup = read_markup(folder / "patient" / "landmarks.mrk.json")
    touched = json.loads((folder / "touches.json").read_bytes())
    places_m = [landmark["place_m"] for landmark in touched["landmarks"]]
    error_m = plan.scene.to_robot(markup.points_m) - places_m

    assert len(touched["touches_m"]) == 40
    assert np.linalg.norm(error_m, axis=1).max() < 3e-3
    assert plan.scene.layers[-1].name == "lesion"
    # The simulated needle points straight down at the planned entry.
    axis = plan.scene.to_robot(plan.scene.target_m) - plan.entry_in_base_m
    assert axis[2] / np.linalg.norm(axis) < -0.999


def test_the_path_for_slicer_is_the_planned_one(folder):
    fields = json.loads((folder / "plan" / "plan.json").read_bytes())
    line = read_markup(folder / "plan" / "path.mrk.json")

    assert line.is_line
    assert np.allclose(
        line.points_m, [fields["entry_m"], fields["target_m"]], atol=1e-6
    )


def test_the_page_shows_slices_and_all_paths(folder):
    page = (folder / "plan" / "index.html").read_text(encoding="utf-8")

    assert page.count("data:image/png") == 2
    assert "not a medical device" in page
    assert re.search(r"clearance of vessel \[mm\]", page)


def test_a_plan_that_is_not_registered_is_refused(folder, capsys, tmp_path):
    fields = json.loads((folder / "plan" / "plan.json").read_bytes())
    del fields["rotation"]
    (tmp_path / "plan.json").write_text(json.dumps(fields), encoding="utf-8")

    assert main(["live", "sim:gel-25-constant", "--plan", str(tmp_path)]) == 2
    assert "needleforce register" in capsys.readouterr().err


def test_landmarks_that_are_not_in_the_ct_are_named(folder, capsys, tmp_path):
    touched = json.loads((folder / "touches.json").read_bytes())
    touched["landmarks"][0]["name"] = "elbow"
    path = tmp_path / "touches.json"
    path.write_text(json.dumps(touched), encoding="utf-8")
    landmarks = folder / "patient" / "landmarks.mrk.json"
    plan = folder / "plan" / "plan.json"
    arguments = f"register --plan {plan} --landmarks {landmarks} --touches {path}"

    assert main([*shlex.split(arguments), "-o", str(tmp_path / "plan.json")]) == 2
    assert "elbow" in capsys.readouterr().err
    assert not (tmp_path / "plan.json").exists()


@pytest.fixture(scope="module")
def by_transform(folder):
    """The command that registers by the transform that the landmarks gave."""
    simple_itk = pytest.importorskip("SimpleITK")
    fields = json.loads((folder / "plan" / "plan.json").read_bytes())
    motion = simple_itk.AffineTransform(3)
    motion.SetMatrix(np.ravel(fields["rotation"]).tolist())
    motion.SetTranslation((1e3 * np.array(fields["translation_m"])).tolist())
    simple_itk.WriteTransform(motion, str(folder / "itk.tfm"))
    options = "--transform itk.tfm --transform-std 2 --touches touches.json"
    return shlex.split(f"register --plan plan/plan.json {options} -o moved.json")


def test_the_inverse_of_a_transform_is_refused_and_the_advice_works(
    folder, by_transform, monkeypatch, capsys
):
    monkeypatch.chdir(folder)

    assert main([*by_transform, "--transform-from", "slicer"]) == 2
    said = capsys.readouterr().err
    assert "Try the other --transform-from" in said
    assert not Path("moved.json").exists()
    assert main([*by_transform, "--transform-from", "itk"]) == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--motion -3", "--motion -3: expected millimetres, 0 or more"),
        ("--touch-std 0", "--touch-std 0: expected millimetres, above 0"),
        ("--negate-xy", "--negate-xy belongs to --landmarks"),
        ("--landmarks-only", "--landmarks-only belongs to --landmarks"),
    ],
)
def test_options_that_a_transform_cannot_take_are_refused(
    folder, by_transform, monkeypatch, capsys, options, said
):
    monkeypatch.chdir(folder)
    arguments = [*by_transform, "--transform-from", "itk", *options.split()]

    assert main(arguments) == 2
    assert said in capsys.readouterr().err


def test_labels_without_names_are_listed_and_mapped(folder, tmp_path, capsys):
    """The error's own advice leads to a plan, which keeps the names."""
    labels = tmp_path / "labels.nii.gz"
    shutil.copy(folder / "patient" / "labels.nii.gz", labels)
    arguments = f"plan --ct {folder}/patient/ct.nii.gz --labels {labels}"
    arguments = [*shlex.split(arguments), "--target", "lesion"]

    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert "there are label_1, label_2, label_3, label_4, label_5, label_6" in said
    assert '--structures "label_1=bone,label_2=rib,' in said

    names = "label_1=vertebra,label_2=rib,3=stomach,4=liver,5=vessel,6=lesion"
    place = tmp_path / "plan"
    assert main([*arguments, "--structures", names, "-o", str(place)]) == 0
    fields = json.loads((place / "plan.json").read_bytes())
    planned = json.loads((folder / "plan" / "plan.json").read_bytes())
    assert fields["structures"]["label_2"] == "rib"
    assert fields["entry_m"] == planned["entry_m"]
    assert [one["name"] for one in fields["layers"]] == [
        one["name"] for one in planned["layers"]
    ]

    names = ("rotation", "translation_m", "covariance", "pivot_m", "registration")
    registered = {key: planned[key] for key in names}
    (place / "plan.json").write_text(json.dumps(fields | registered), encoding="utf-8")
    assert read_plan(place).scene.layers[-1].name == "lesion"


@pytest.mark.parametrize("source", ["slicer", "itk"])
def test_a_transform_registers_and_touches_check_it(folder, tmp_path, capsys, source):
    sitk = pytest.importorskip("SimpleITK")
    fields = json.loads((folder / "plan" / "plan.json").read_bytes())
    transform = sitk.AffineTransform(3)
    transform.SetMatrix(np.ravel(fields["rotation"]).tolist())
    transform.SetTranslation((1e3 * np.array(fields["translation_m"])).tolist())
    sitk.WriteTransform(transform, str(tmp_path / "a.h5"))
    arguments = f"register --plan {folder}/plan/plan.json --transform {tmp_path}/a.h5"
    arguments += f" --transform-from {source} --touches {folder}/touches.json"
    arguments = [*shlex.split(arguments), "-o", str(tmp_path / "plan.json")]

    assert main(arguments) == 2
    assert "--transform-std" in capsys.readouterr().err

    is_right = source == "itk"
    assert main([*arguments, "--transform-std", "1"]) == (0 if is_right else 2)
    if is_right:
        written = json.loads((tmp_path / "plan.json").read_bytes())
        assert written["rotation"] == pytest.approx(np.array(fields["rotation"]))
    else:
        assert "mm (rms) from the skin" in capsys.readouterr().err
        assert not (tmp_path / "plan.json").exists()


def test_a_situs_inversus_of_no_plan_is_refused(capsys):
    assert main(["live", "sim:gel-25-constant", "--situs-inversus"]) == 2
    assert "expected --plan" in capsys.readouterr().err


def test_the_last_command_names_the_lesion(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    monkeypatch.setattr("needleforce.cli.arms.arm_connection.pace", lambda arm: arm)
    patient = "needleforce.simulation.patient"
    monkeypatch.setattr(f"{patient}.SPEED_m_s", QUICK_m_s)

    assert main(commands()[-1]) == 0
    assert re.search(r"rupture of layer \d .*by the plan into lesion", _said(capsys))


def test_keys_record_undo_and_end(folder, capsys, monkeypatch, tmp_path):
    openpty = pytest.importorskip("pty").openpty
    keyboard, terminal = openpty()
    # Before the first moment Enter records nothing; two lines then are one too many.
    os.write(keyboard, b"\n\nu\n\n\nQ\n")
    output = tmp_path / "touches.json"
    with os.fdopen(terminal, encoding="utf-8") as typed:
        monkeypatch.setattr("sys.stdin", typed)
        arm = f"sim:{folder / 'plan' / 'plan.json'}"

        assert main(["touch", arm, "-o", str(output)]) == 0

    os.close(keyboard)

    assert len(json.loads(output.read_bytes())["touches_m"]) == 2
    assert "undone" in _said(capsys)


def test_landmarks_in_the_other_frame_are_refused_and_can_be_negated(
    folder, capsys, tmp_path
):
    landmarks = tmp_path / "ras.mrk.json"
    text = (folder / "patient" / "landmarks.mrk.json").read_text(encoding="utf-8")
    landmarks.write_text(text.replace("LPS", "RAS"), encoding="utf-8")
    plan = folder / "plan" / "plan.json"
    output = tmp_path / "plan.json"
    arguments = shlex.split(
        f"register --plan {plan} --landmarks {landmarks} --touches "
        f"{folder / 'touches.json'} -o {output}"
    )

    assert main(arguments) == 2
    assert "--negate-xy" in capsys.readouterr().err
    assert not output.exists()
    assert main([*arguments, "--negate-xy"]) == 0
    assert np.allclose(
        json.loads(output.read_bytes())["rotation"],
        json.loads(plan.read_bytes())["rotation"],
        atol=1e-3,
    )


def _said(capsys):
    """All that was said, on both streams."""
    captured = capsys.readouterr()
    return captured.out + captured.err
