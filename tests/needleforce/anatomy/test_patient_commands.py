"""From a CT to a registered plan, by commands alone; a wrong place is never silent."""

import json
import os
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import SimpleITK

from needleforce import PlanFileError, read_plan
from needleforce.anatomy import read_markup, write_markup
from needleforce.cli import main
from tests.needleforce.anatomy import made_files as made

pytestmark = pytest.mark.slow

SCRIPT = Path(__file__).parents[3] / "examples" / "ct_to_insertion.sh"
COARSE_m = (4e-3, 4e-3, 5e-3)
"""Voxels of the torso here: a quarter of the usual number."""


def commands():
    """The commands of the example, but for the last, which runs for a minute."""
    lines = SCRIPT.read_text(encoding="utf-8").splitlines()
    return [shlex.split(line)[1:] for line in lines if line.startswith("needleforce")]


@pytest.fixture(scope="module", autouse=True)
def folder(tmp_path_factory):
    """Where the example was run on a coarse CT, up to the insertion."""
    place = tmp_path_factory.mktemp("patient")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setattr("needleforce.simulation.torso_case.SPACING_m", COARSE_m)
        patch.setattr("needleforce.cli.patient.plan_page.find_spec", lambda name: None)
        patch.setattr("needleforce.plan_file._large_surfaces", lambda *_: ())
        for arguments in commands()[:-1]:
            assert main(arguments) == 0
        yield place


def load(path):
    return json.loads(Path(path).read_bytes())


@pytest.fixture
def fields(folder):
    return load(folder / "plan" / "plan.json")


def obey(line):
    """Run a command that must succeed."""
    assert main(shlex.split(line)) == 0


def run(capsys, line):
    """Run a command that is refused with one line; return what it says."""
    assert main([*shlex.split(line), "-o", "made"]) == 2
    assert not Path("made").exists()
    said = capsys.readouterr().err
    assert said.startswith("error: ") or "\nerror: " in said
    return said


def read(fields, name="wrong.json"):
    path = Path("plan") / name
    path.write_text(json.dumps(fields), encoding="utf-8")
    return read_plan(path)


def test_the_registered_plan_lies_where_the_patient_is(fields):
    plan = read_plan("plan/plan.json")
    landmarks_m = read_markup("patient/landmarks.mrk.json").points_m
    touched = load("touches.json")
    places_m = [landmark["place_m"] for landmark in touched["landmarks"]]
    error_m = plan.scene.to_robot(landmarks_m) - places_m
    # The simulated needle points straight down at the planned entry.
    axis = plan.scene.to_robot(plan.scene.target_m) - plan.path.entry_m
    line_m = read_markup("plan/path.mrk.json").points_m
    page = Path("plan/index.html").read_text(encoding="utf-8")

    assert (plan.warnings, len(commands()), len(touched["touches_m"])) == ((), 5, 40)
    assert np.linalg.norm(error_m, axis=1).max() < 3e-3
    assert plan.scene.layers[-1].name == "lesion"
    assert set(fields["made_of"]["avoided"]) == set(plan.surroundings.names)
    assert axis[2] / np.linalg.norm(axis) < -0.999
    ends_m = [fields["entry_m"], fields["target_m"]]
    np.testing.assert_allclose(line_m, ends_m, atol=1e-6)
    assert page.count("data:image/png") == 2
    assert re.search(
        "not a medical device.*vessel|vessel.*not a medical", page, re.DOTALL
    )


def test_what_a_registration_leaves_is_reported(capsys, fields):
    register = (
        "register --plan plan --landmarks patient/landmarks.mrk.json "
        "--touches touches.json -o"
    )
    obey(f"{register} again.json")
    said = capsys.readouterr().out
    again = load("again.json")
    error_mm = 1e3 * again["registration"]["target_error_rms_m"]
    region_mm = [float(one) for one in re.findall(r"(\d+\.\d)(?= x | mm \(half)", said)]

    for key in ("rotation", "covariance", "offset_std_m", "pivot_m"):
        np.testing.assert_allclose(again[key], fields[key])
    assert len(re.findall(r"landmark .*residual \d\.\d mm", said)) == 6
    assert f"{error_mm:.1f} mm rms" in said
    assert region_mm == sorted(region_mm, reverse=True)
    assert 1.4 * error_mm < np.linalg.norm(region_mm) < 6.0 * error_mm
    # The layers are as uncertain as registration and organs together.
    assert 3e-3 < again["offset_std_m"] < np.hypot(3e-3, 1e-3 * error_mm)
    obey(f"{register} alone.json --landmarks-only --motion 0")
    few = load("alone.json")
    assert few["offset_std_m"] != pytest.approx(again["offset_std_m"], rel=0.1)
    assert few["registration"]["touch_distances_m"] == []


def test_the_last_command_names_the_lesion(capsys, monkeypatch):
    monkeypatch.setattr("needleforce.cli.arms.arm_connection.pace", lambda arm: arm)
    monkeypatch.setattr("needleforce.simulation.patient.SPEED_m_s", 10e-3)

    assert main(commands()[-1]) == 0
    said = "".join(capsys.readouterr())
    assert re.search(r"rupture of layer \d .*by the plan into lesion", said)


def moved_files(name, shift_mm=(0.0, 0.0, 0.0), change=lambda voxels, file: voxels):
    """Copy CT and labels to another place, or change their voxels."""
    folder = Path(name)
    folder.mkdir(exist_ok=True)
    for file in ("ct.nii.gz", "labels.nii.gz"):
        image = SimpleITK.ReadImage(f"patient/{file}")
        voxels = change(SimpleITK.GetArrayFromImage(image).T.copy(), file)
        origin_mm = np.add(image.GetOrigin(), shift_mm).tolist()
        made.write_image(folder / file, voxels, image.GetSpacing(), origin_mm)
    (folder / "labels.json").write_bytes(Path("patient/labels.json").read_bytes())
    return {"ct": f"../{name}/ct.nii.gz", "labels": f"../{name}/labels.nii.gz"}


def touch_up(voxels, file):
    """Change one voxel of the CT."""
    voxels[5, 5, 5] += "ct" in file
    return voxels


def with_change(fields, key, change):
    return {**fields, key: change(np.array(fields[key])).tolist()}


def with_layer_of(fields, **changes):
    return {**fields, "layers": [{**one, **changes} for one in fields["layers"]]}


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda f: f | moved_files("other", change=lambda v, _: v[:-4]), "made of"),
        (lambda f: f | moved_files("shifted", (0.0, 0.0, 20.0)), "made of"),
        (
            lambda f: f | {"labels": moved_files("shifted", (0, 0, 20.0))["labels"]},
            "made of",
        ),
        (
            lambda f: f | moved_files("touched-up", change=touch_up),
            "made of",
        ),
        (
            lambda f: (
                f | moved_files("empty", change=lambda v, file: v * ("ct" in file))
            ),
            "no voxel",
        ),
        (lambda f: f | {"entry_m": f["target_m"], "target_m": f["entry_m"]}, "entry"),
        (lambda f: with_change(f, "entry_m", lambda p: p * [-1, 1, 1]), "entry"),
        (
            lambda f: with_change(f, "target_m", lambda p: p + 0.03 * np.eye(3)[2]),
            "target",
        ),
        (
            lambda f: with_change(f, "rotation", lambda r: r @ np.diag([-1, -1, 1])),
            "register",
        ),
        (lambda f: with_change(f, "covariance", lambda c: 1e4 * c), "error"),
        (lambda f: with_change(f, "covariance", lambda c: 1e-8 * c), "error"),
        (lambda f: {k: f[k] for k in f if k != "covariance"}, "register"),
        (lambda f: {k: f[k] for k in f if k != "made_of"}, "made of"),
        (lambda f: {k: f[k] for k in f if k != "rotation"}, "register"),
        (lambda f: {k: f[k] for k in f if k != "registration"}, "regist"),
        (lambda f: f | {"version": 1}, "version 1"),
        (lambda f: f | {"version": 4}, "version 4"),
        (lambda f: f | {"ct": ""}, "CT"),
        (lambda f: f | {"margin_m": 0.08}, "made of"),
        (lambda f: with_layer_of(f, name="RightRib9"), "made of"),
        (lambda f: with_layer_of(f, is_obstacle=True), "fat"),
    ],
)
def test_a_plan_that_does_not_fit_is_refused(fields, change, word):
    with pytest.raises(PlanFileError, match=word):
        read(change(dict(fields)))


@pytest.mark.parametrize(
    ("name", "is_refused"), [("RightRib9", True), ("liver", False)]
)
def test_a_path_past_a_rib_is_refused_however_the_rib_is_called(
    tmp_path, name, is_refused
):
    values = np.zeros((30, 40, 30), np.uint8)
    values[10:14, 14:, :] = 1
    values[20:, :13, :] = 2
    made.write_image(tmp_path / "labels.nii.gz", values)
    (tmp_path / "plan.json").write_text(
        '{"entry_m": [0.0, 0.01, 0.015], "target_m": [0.028, 0.01, 0.015]}'
    )
    (tmp_path / "labels.json").write_text(json.dumps({"1": name, "2": "muscle"}))
    with made.refused_if(is_refused, name, PlanFileError):
        assert read_plan(tmp_path).warnings


REGISTER = "register --plan plan/plan.json --landmarks {} --touches {}"


def test_landmarks_in_the_other_frame_are_refused_and_can_be_negated(capsys, fields):
    text = Path("patient/landmarks.mrk.json").read_text(encoding="utf-8")
    Path("ras.mrk.json").write_text(text.replace("LPS", "RAS"), encoding="utf-8")
    line = REGISTER.format("ras.mrk.json", "touches.json")

    assert "--negate-xy" in run(capsys, line)
    obey(f"{line} --negate-xy -o negated.json")
    turn = load("negated.json")["rotation"]
    np.testing.assert_allclose(turn, fields["rotation"], atol=1e-3)


def test_lists_of_other_programs_register_as_those_of_ours(capsys, fields):
    """They say neither unit nor frame: both are asked for."""
    markup = read_markup("patient/landmarks.mrk.json")
    touched = load("touches.json")
    landmarks_mm = 1e3 * markup.points_m * [-1.0, -1.0, 1.0]
    slicers = ["# columns = id,x,y,z,vis,label"]
    for name, (x_mm, y_mm, z_mm) in zip(markup.names, landmarks_mm, strict=True):
        slicers.append(f"1,{x_mm:.4f},{y_mm:.4f},{z_mm:.4f},1,{name}")
    Path("points.fcsv").write_text("\n".join(slicers), encoding="utf-8")
    places = [(one["name"], *one["place_m"]) for one in touched["landmarks"]]
    places += [("", *place_m) for place_m in touched["touches_m"]]
    table = pd.DataFrame(places, columns=["name", "x", "y", "z"])
    table[["x", "y", "z"]] *= 1e3
    table.to_csv("touched.csv", index=False, float_format="%.4f")
    line = REGISTER.format("points.fcsv", "touched.csv")
    obey(f"{line} --unit mm --frame ras -o listed.json")
    place_m = load("listed.json")["registration"]["target_in_base_m"]
    expected_m = fields["registration"]["target_in_base_m"]

    np.testing.assert_allclose(place_m, expected_m, atol=1e-5)
    assert "--unit" in run(capsys, f"{line} --frame ras")
    assert "--frame" in run(capsys, f"{line} --unit mm")
    in_ct = "\n".join(["# CoordinateSystem = RAS", *slicers])
    Path("ct.fcsv").write_text(in_ct, encoding="utf-8")
    assert "base" in run(capsys, REGISTER.format("ct.fcsv", "ct.fcsv"))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda t: t["landmarks"][0].update(name="elbow"), "elbow"),
        (lambda t: t["landmarks"][0].update(name="navel"), "navel"),
        (lambda t: t["landmarks"][0].update(place_m=[0.5, 0.5, 0.5]), "landmarks"),
        (lambda t: t.update(landmarks=t["landmarks"][:2]), "2"),
        (lambda t: t.update(version=2), "version"),
        (lambda t: t.update(touches_m=t["touches_m"][:9]), "9"),
        (lambda t: t.update(places_m=[]), "places_m"),
        (
            lambda t: t.update(touches_m=np.add(t["touches_m"], 0.012).tolist()),
            "moved|touches",
        ),
    ],
)
def test_touches_that_do_not_fit_are_refused(capsys, change, word):
    touched = load("touches.json")
    change(touched)
    Path("wrong.json").write_text(json.dumps(touched), encoding="utf-8")
    line = REGISTER.format("patient/landmarks.mrk.json", "wrong.json")

    assert re.search(word, run(capsys, line))


@pytest.fixture(scope="module")
def by_transform(folder):
    """The command that registers by the transform that the landmarks gave."""
    fields = load(folder / "plan" / "plan.json")
    shift_mm = (1e3 * np.array(fields["translation_m"])).tolist()
    motion = SimpleITK.AffineTransform(np.ravel(fields["rotation"]).tolist(), shift_mm)
    SimpleITK.WriteTransform(motion, str(folder / "itk.tfm"))
    return "register --transform itk.tfm --plan "


RIGHT = "--transform-from itk --transform-std 2 --touches touches.json"


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ("--transform-from slicer --transform-std 2 --touches touches.json", "skin"),
        ("--transform-std 2", "--transform-from"),
        ("--transform-from itk", "--transform-std"),
        ("--transform-from itk --transform-std 0", "--transform-std"),
        (f"{RIGHT} --motion -3", "-3"),
        (f"{RIGHT} --touch-std 0", "--touch-std"),
        (f"{RIGHT} --motion 60", "60"),
        (f"{RIGHT} --negate-xy", "--negate-xy"),
        (f"{RIGHT} --landmarks-only", "--landmarks-only"),
    ],
)
def test_a_wrong_or_unsaid_transform_is_refused(capsys, by_transform, options, word):
    assert word in run(capsys, f"{by_transform} plan {options}")


def test_a_transform_registers_and_obstacles_are_judged_with_its_deviation(
    capsys, by_transform, fields
):
    ct = "--ct patient/ct.nii.gz --labels patient/labels.nii.gz --target lesion"
    obey(f"plan {ct} --passable vessel --margin 55 -o wide")
    obey(f"{by_transform} plan {RIGHT} -o right.json")
    turn = load("right.json")["rotation"]
    np.testing.assert_allclose(turn, fields["rotation"], atol=1e-9)
    assert read_plan("right.json").path is not None
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([fields["rotation"], fields["translation_m"]])
    np.savetxt("matrix.txt", matrix)
    obey(f"register --transform matrix.txt --unit m --plan plan {RIGHT} -o right.json")
    np.testing.assert_allclose(load("right.json")["rotation"], turn, atol=1e-9)
    wide = f"{by_transform} wide --transform-from itk --transform-std"
    assert "rib_right" in run(capsys, f"{wide} 1")
    obey(f"{wide} 0.2 -o wide/plan.json")
    assert read_plan("wide").surroundings is not None


PLAN = "plan --ct patient/ct.nii.gz --labels {} --target {}"


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ("--radius 0.05", "--radius"),
        ("--margin -1", "--margin"),
        ("--max-length 600", "--max-length"),
        ("--cone 91", "--cone"),
        ("--choose 0", "--choose"),
        ("--choose 99", "99"),
        ("--passable rib_right", "rib_right"),
        ("--passable spleen", "spleen"),
        ("--max-length 20", "20 mm"),
        ("--structures label_1=boen", "boen"),
        ("--structures label_1=", "NAME=KIND"),
        ("--structures label_1=rib,label_1=liver", "twice"),
        ("--structures none.json", "none.json"),
        ("--situs-inversus --structures 4=liver,6=lesion,3=spleen", "situs"),
    ],
)
def test_wishes_that_cannot_be_are_refused(capsys, options, word):
    line = PLAN.format("patient/labels.nii.gz", "lesion")

    assert word in run(capsys, f"{line} {options}")


def test_labels_without_names_are_listed_and_mapped(capsys, fields):
    labels = Path("bare/labels.nii.gz")
    labels.parent.mkdir()
    labels.write_bytes(Path("patient/labels.nii.gz").read_bytes())
    line = PLAN.format(labels, "lesion")
    some = "label_1=vertebra,label_2=rib,3=stomach,4=liver"

    assert "label_6" in run(capsys, line)
    assert "label_5" in run(capsys, f"{line} --structures {some},6=lesion")
    names = f"--structures {some},5=vessel,6=lesion"
    obey(f"{line} {names} -o mapped")
    plan = load("mapped/plan.json")
    found = (plan["structures"]["label_2"], plan["entry_m"])
    assert found == ("rib", fields["entry_m"])
    keys = ("rotation", "translation_m", "covariance", "pivot_m", "registration")
    registered = plan | {key: fields[key] for key in keys}
    Path("mapped/plan.json").write_text(json.dumps(registered), encoding="utf-8")
    assert read_plan("mapped").scene.layers[-1].name == "lesion"


def test_a_point_is_a_target_and_a_line_a_path(capsys, fields):
    ends_m = np.array([fields["entry_m"], fields["target_m"]])
    outside_m = ends_m[0] + 0.05 * (ends_m[0] - ends_m[1])
    write_markup("point.mrk.json", "Fiducial", ["here"], ends_m[1:])
    write_markup("line.mrk.json", "Line", ["b", "a"], np.array([ends_m[1], outside_m]))
    x_mm, y_mm, z_mm = 1e3 * ends_m[1]
    Path("P.TXT").write_text(f"x_mm,y_mm,z_mm\n{x_mm},{y_mm},{z_mm}\n")
    for name, file in (
        ("text", "P.TXT --frame lps"),
        ("point", "point.mrk.json"),
        ("line", "line.mrk.json"),
    ):
        line = PLAN.format("patient/labels.nii.gz", file)
        obey(f"{line} --passable liver -o {name}")
        plan = load(f"{name}/plan.json")
        np.testing.assert_allclose(plan["target_m"], ends_m[1], atol=1e-6)
    np.testing.assert_allclose(plan["entry_m"], ends_m[0], atol=3e-3)
    # A line is judged as a path that is offered: what it must avoid stays clear of it.
    assert "rib_right" in run(capsys, f"{line} --margin 60")
    assert "liver" in run(capsys, f"{line} --avoid liver --margin 20")


def test_keys_record_undo_and_end(capsys, monkeypatch):
    keyboard, terminal = pytest.importorskip("pty").openpty()
    # Before the first moment Enter records nothing; two lines then are one too many.
    os.write(keyboard, b"\n\nu\n\n\nQ\n")
    with os.fdopen(terminal, encoding="utf-8") as typed:
        monkeypatch.setattr("sys.stdin", typed)
        assert main(shlex.split("touch sim:plan/plan.json -o keys.json")) == 0
    os.close(keyboard)

    assert len(load("keys.json")["touches_m"]) == 2
    assert "undone" in "".join(capsys.readouterr())
    for option, value in (("--count", -1), ("--contact", 0)):
        assert option in run(capsys, f"touch sim:plan/plan.json {option} {value}")
