"""The command `needleforce live`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import ARMS, LIVE_OUTPUT, LOG, TARE, app
from needleforce.cli.loop_threads import limit_library_threads
from needleforce.cli.shared_options import (
    TARE_S,
    ArmName,
    ArmOptions,
    Direction,
    RobotOptions,
)

SWIVEL_DEG = 0.0
"""Swing of the elbow during a stroke before the tare, without ``--tare-swivel``: a
slow stroke alone gives as good a force on the simulated arms."""


@Parameter(name="*", group=LIVE_OUTPUT)
@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """What an arm is watched with.

    Attributes:
        plan: Plan to match ruptures with (plan.json, or its folder): see
            docs/how-to/scene.md.
        situs_inversus: Liver and spleen of the plan's patient are exchanged.
        reference: ATI Net F/T between flange and tool: its axial force, and the rms
            difference since the tare, are shown next to the estimate.
        reference_axis: Direction of insertion in that sensor's axes (default: 0 0 1).
        view: Serve the scene as a browser page beside the session.
        port: Port of that page (default: 8080); another is used if it is busy.
        tare: Tare after so many seconds of motion without contact (default: 4); if it
            is refused, again after as many.
        tare_stroke: Move the arm and tare from that, before anything else: it draws the
            needle back by so many mm and returns. It asks first.
        tare_swivel: Degrees by which the elbow of an arm of seven joints swings during
            that stroke (default: 0; 8 is slow enough).
        yes: Move the arm without asking.
    """

    plan: Annotated[Path | None, Parameter(metavar="FILE", group=LOG)] = None
    situs_inversus: Annotated[bool, Parameter(negative="", group=LOG)] = False
    reference: Annotated[str | None, Parameter(metavar="ADDRESS", group=LOG)] = None
    reference_axis: Annotated[Direction, Parameter(metavar="X Y Z", group=LOG)] = (
        0.0,
        0.0,
        1.0,
    )
    view: Annotated[bool, Parameter(negative="")] = False
    port: Annotated[int, Parameter(metavar="N")] = 8080
    tare: Annotated[float, Parameter(metavar="S", group=TARE)] = TARE_S
    tare_stroke: Annotated[float | None, Parameter(metavar="MM", group=TARE)] = None
    tare_swivel: Annotated[float, Parameter(metavar="DEGREES", group=TARE)] = SWIVEL_DEG
    yes: Annotated[bool, Parameter(negative="", group=TARE)] = False


@app.command(name="live", group=ARMS)
def live_command(
    arm: ArmName,
    /,
    *,
    options: ArmOptions = ArmOptions(),
    watch: WatchOptions = WatchOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Watch an arm until Ctrl-C: forces, depth, ruptures, warnings.

    Move the needle in free air first: the tare is taken after --tare seconds. Or let
    the arm make that stroke itself: --tare-stroke MM.

    needleforce live sim:stack-glove-constant --view
    """
    limit_library_threads()
    from needleforce.cli.arms.arm_stroke import TareOptions, find_stroke
    from needleforce.cli.arms.arm_watch import ReferenceSensor, watch_arm

    motion = find_stroke(watch.tare_stroke, watch.tare_swivel)
    sensor = None
    if watch.reference is not None:
        sensor = ReferenceSensor(watch.reference, watch.reference_axis)
    return watch_arm(
        arm,
        options,
        robot,
        taring=TareOptions(watch.tare, motion, is_confirmed=watch.yes),
        plan_path=watch.plan,
        situs_inversus=watch.situs_inversus,
        reference_sensor=sensor,
        page_port=watch.port if watch.view else None,
    )
