"""Options of `record`, `live`, `view` and `demo`; the text below a field is its
help.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from needleforce.cli.options import LOG, TARE

OUTPUT = Group("Output", sort_key=2)

Constants = tuple[float, float, float, float, float, float]
Vector = tuple[float, float, float]


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class LiveOptions:
    """How long an arm is listened to.

    Attributes:
        seconds: Stop after this time [s]; else at Ctrl-C or when the arm stops sending.
        motor_constants: For ur: joint torque per motor current of each joint [Nm/A]; a
            UR sends no torques (docs/panda.md).
    """

    seconds: Annotated[float, Parameter(metavar="S")] = float("inf")
    motor_constants: Annotated[Constants | None, Parameter(metavar="K1 ... K6")] = None


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """What an arm is watched with.

    Attributes:
        plan: Plan to match ruptures with (plan.json, or its folder): see docs/scene.md.
        reference: ATI Net F/T between flange and tool: its axial force, and the rms
            difference since the tare, are shown next to the estimate.
        reference_axis: Direction of insertion in that sensor's axes (default: 0 0 1).
        view: Serve the scene as a browser page beside the session.
        port: Port of that page (default: 8080); another is used if it is busy.
        tare: Tare after so many seconds of motion without contact (default: 4); if it
            is refused, again after as many.
    """

    plan: Annotated[Path | None, Parameter(metavar="FILE", group=LOG)] = None
    reference: Annotated[str | None, Parameter(metavar="ADDRESS", group=LOG)] = None
    reference_axis: Annotated[Vector, Parameter(metavar="X Y Z", group=LOG)] = (
        0.0,
        0.0,
        1.0,
    )
    view: Annotated[bool, Parameter(negative="")] = False
    port: Annotated[int, Parameter(metavar="N")] = 8080
    tare: Annotated[float, Parameter(metavar="S", group=TARE)] = 4.0


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """What is shown beside a recording, and where.

    Attributes:
        anatomy: Folder with plan.json and labels.nii.gz (or .nrrd, .seg.nrrd): see
            docs/scene.md.
        mapping: TOML file that says which columns are which, as `needleforce force
            --print-config` writes.
        tare: Tare after so many seconds of motion without contact (default: 4); if it
            is refused, again after as many.
        export: Write the scene as one page (.html) with the insertion as a film, and
            end.
        host: Address on which the page is served (default: 127.0.0.1, this machine
            alone).
        port: Port of that page (default: 8080); another is used if it is busy.
    """

    anatomy: Annotated[Path | None, Parameter(metavar="DIR")] = None
    mapping: Annotated[str | None, Parameter(metavar="FILE")] = None
    tare: Annotated[float, Parameter(metavar="S", group=TARE)] = 4.0
    export: Annotated[Path | None, Parameter(metavar="FILE", group=OUTPUT)] = None
    host: Annotated[str, Parameter(metavar="ADDRESS", group=OUTPUT)] = "127.0.0.1"
    port: Annotated[int, Parameter(metavar="N", group=OUTPUT)] = 8080


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class DemoOptions:
    """Where a demonstration goes, and what that of the abdomen begins with.

    Attributes:
        report: Folder for a page.
        figure: First figure of that page: .png, .svg or .pdf.
        data: For abdomen: folder with ct.nii.gz and labels.nii.gz; else an analytic
            torso.
        seed: For abdomen.
    """

    report: Annotated[Path | None, Parameter(metavar="DIR")] = None
    figure: Annotated[
        Path | None, Parameter(name=("--figure", "--png"), metavar="FILE")
    ] = None
    data: Annotated[Path | None, Parameter(metavar="DIR", group=LOG)] = None
    seed: Annotated[int, Parameter(metavar="N", group=LOG)] = 0
