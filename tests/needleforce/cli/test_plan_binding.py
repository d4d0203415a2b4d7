"""A plan knows what it was made of: what does not fit is refused, with the reason."""

import json
import shutil
from copy import deepcopy

import numpy as np
import pytest
import SimpleITK
from scipy.spatial.transform import Rotation

from needleforce import plan_file
from needleforce.anatomy import Registration
from needleforce.cli import main
from needleforce.cli.patient.case_files import read_plan_fields, write_plan_fields
from needleforce.cli.patient.register_report import FitReport
from needleforce.cli.patient.register_run import _fit_fields
from needleforce.plan_file import PlanFileError, read_plan

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


def registered(fields, seed=1000):
    """The fields of a plan with a registration of some place and some accuracy."""
    rng = np.random.default_rng(seed)
    root = np.diag([2e-3] * 3 + [0.3e-3] * 3) @ rng.normal(0.0, 1.0, (6, 6))
    fit = Registration(
        Rotation.random(random_state=seed).as_matrix(),
        rng.normal(0.0, 0.3, 3),
        root @ root.T,
        rng.normal(0.0, 0.1, 3),
        np.inf,
        0.0,
    )
    entry_m = np.array(fields["entry_m"])
    target_m = np.array(fields["target_m"])
    return {**fields, **_fit_fields(FitReport(fit, (), (), entry_m, target_m, 3e-3))}


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("case")
    patient = folder / "patient"
    assert main(["simulate", "torso", "-o", str(patient)]) == 0
    ct = str(patient / "ct.nii.gz")
    labels = str(patient / "labels.nii.gz")
    argv = ["plan", "--ct", ct, "--labels", labels, "--target", "lesion"]
    assert main([*argv, "--radius", "0.6", "-o", str(folder / "plan")]) == 0
    return folder


@pytest.fixture(scope="module")
def fields(case):
    plan = registered(read_plan_fields(case / "plan"))
    write_plan_fields(case / "plan" / "right.json", plan)
    return json.loads((case / "plan" / "right.json").read_bytes())


@pytest.fixture(autouse=True)
def without_surfaces(monkeypatch):
    """Nobody looks at the structures here."""
    monkeypatch.setattr(plan_file, "_large_surfaces", lambda *_: ())


def read(case, fields, name="wrong.json"):
    path = case / "plan" / name
    write_plan_fields(path, fields)
    return read_plan(path)


def refusal(case, fields):
    with pytest.raises(PlanFileError) as refused:
        read(case, fields)
    text = str(refused.value)
    assert text.startswith(str(case / "plan" / "wrong.json"))
    return text


def test_the_plan_says_what_it_was_made_of(fields):
    made_of = fields["made_of"]

    assert fields["version"] == 2
    assert fields["needle_radius_m"] == pytest.approx(0.6e-3)
    assert len(made_of["ct"]["sha256"]) == len(made_of["labels"]["sha256"]) == 64
    assert set(made_of["avoided"]) == {"vertebra", "rib_right", "stomach", "vessel"}


def test_a_right_plan_passes_without_a_warning(case, fields):
    assert read(case, fields).warnings == ()


def moved_files(case, name, shift_mm=(0.0, 0.0, 0.0), change=None):
    folder = case / name
    folder.mkdir(exist_ok=True)
    for file in ("ct.nii.gz", "labels.nii.gz"):
        image = SimpleITK.ReadImage(str(case / "patient" / file))
        voxels = SimpleITK.GetArrayFromImage(image)
        if change is not None:
            voxels = change(voxels, file)
        copy = SimpleITK.GetImageFromArray(np.ascontiguousarray(voxels))
        copy.SetSpacing(image.GetSpacing())
        copy.SetDirection(image.GetDirection())
        copy.SetOrigin(np.add(image.GetOrigin(), shift_mm).tolist())
        SimpleITK.WriteImage(copy, str(folder / file))
    shutil.copy(case / "patient" / "labels.json", folder)
    return {"ct": f"../{name}/ct.nii.gz", "labels": f"../{name}/labels.nii.gz"}


def test_another_patient_is_refused(case, fields):
    files = moved_files(case, "other", change=lambda voxels, file: voxels[:, :-8])

    assert "another patient or scan" in refusal(case, {**fields, **files})


def test_a_scan_that_lies_20_mm_elsewhere_is_refused(case, fields):
    files = moved_files(case, "shifted", (0.0, 0.0, 20.0))

    assert "20.0 mm lie between the CT now and" in refusal(case, {**fields, **files})
    only_labels = {**fields, "labels": files["labels"]}
    assert "20.0 mm lie between the labels now and" in refusal(case, only_labels)


def test_another_patient_on_the_same_grid_is_refused(case, fields):
    files = moved_files(
        case, "rolled", change=lambda voxels, file: np.roll(voxels, 6, axis=1)
    )

    assert "have changed since the plan was made, and " in refusal(
        case, {**fields, **files}
    )


def test_other_voxels_with_the_same_layers_are_a_warning(case, fields):
    def add_noise(voxels, file):
        voxels = voxels.copy()
        if file.startswith("ct"):
            voxels[5, 5, 5] += 1
        return voxels

    files = moved_files(case, "touched-up", change=add_noise)
    (warning,) = read(case, {**fields, **files}).warnings

    assert warning.startswith("the voxels of the CT have changed since the plan was")


def test_exchanged_ends_and_a_moved_target_are_refused(case, fields):
    exchanged = deepcopy(fields)
    exchanged["entry_m"] = fields["target_m"]
    exchanged["target_m"] = fields["entry_m"]
    moved = deepcopy(fields)
    moved["target_m"][2] += 0.03

    assert "its entry lies 69.4 mm from where it was registered" in refusal(
        case, exchanged
    )
    assert "its target lies 30.0 mm from where it was registered" in refusal(
        case, moved
    )


def test_a_transform_in_ras_or_a_scaled_covariance_is_refused(case, fields):
    turned = deepcopy(fields)
    turned["rotation"] = (np.array(fields["rotation"]) @ np.diag([-1, -1, 1])).tolist()

    assert "RAS for LPS" in refusal(case, turned)
    for factor in (1e-8, 1e4):
        scaled = deepcopy(fields)
        scaled["covariance"] = (factor * np.array(fields["covariance"])).tolist()
        assert "the covariance was changed" in refusal(case, scaled)
    without = deepcopy(fields)
    del without["covariance"]
    assert "no covariance" in refusal(case, without)


def test_a_plan_of_version_0_2_or_without_what_it_was_made_of_is_refused(case, fields):
    for version in (1, 3):
        assert f"version {version}" in refusal(case, {**fields, "version": version})
    without = {key: value for key, value in fields.items() if key != "made_of"}
    assert "does not say what it was made of" in refusal(case, without)


@pytest.mark.parametrize("seed", range(1001, 1021))
def test_right_registrations_pass(case, fields, seed):
    assert read(case, registered(fields, seed), "right.json").path is not None
