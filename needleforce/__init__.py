"""Needle-tip force from a robot's joint torques: the front door of the toolkit.

    session = InsertionSession(load_lwr(payload=NeedleTool()))
    estimate = session.update(q, dq, tau, dt_s)     # every tick
    session.tare()                                  # once, in free air

The names below live in `urdf`, `residual`, `identification` and the modules of this
package; each is imported when it is first used, so that ``import needleforce`` costs
next to nothing.

Reading order: `session` (the whole chain, tick by tick), `insertion_course` (where an
insertion begins and ends), `rewinding` (what a push on the arm undoes), `zero_watch`
(what shows another zero), `session_snapshot`; `plan_follower` (a plan beside it),
`plan_file` (a plan from its file), `needle_on_plan` (whether the needle is on it),
`session_replay` (over a recording, or the virtual sensor alone), `tare_run` (when it is
tared), `recorder` (an arm's signals into a file); then the packages `recordings`,
`plots`, `cli`, `control` (what moves the needle), `anatomy` (what it enters),
`simulation`.
"""

from importlib import import_module
from importlib.util import find_spec
from os.path import dirname, join, realpath
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from foundation.errors import NeedleforceError as NeedleforceError
    from identification import (
        Estimate as Estimate,
        Identifier as Identifier,
        LayerEstimate as LayerEstimate,
        MixtureConfig as MixtureConfig,
        PublishedConfig as PublishedConfig,
        Rupture as Rupture,
        replay as replay,
    )
    from needleforce.insertion_events import (
        SessionEvent as SessionEvent,
        session_events as session_events,
    )
    from needleforce.needle_channels import ChannelState as ChannelState
    from needleforce.needle_on_plan import (
        PlanDeviation as PlanDeviation,
        PlannedPath as PlannedPath,
    )
    from needleforce.plan_file import (
        PlanFileError as PlanFileError,
        read_plan as read_plan,
    )
    from needleforce.recorder import (
        Recorder as Recorder,
        RecorderError as RecorderError,
    )
    from needleforce.session import (
        InsertionSession as InsertionSession,
        SessionEstimate as SessionEstimate,
    )
    from needleforce.session_replay import replay_session as replay_session
    from needleforce.session_snapshot import (
        InsertionError as InsertionError,
        SessionSnapshot as SessionSnapshot,
        SnapshotFileError as SnapshotFileError,
        read_snapshot as read_snapshot,
        write_snapshot as write_snapshot,
    )
    from needleforce.tare_run import AutoTare as AutoTare, TareRun as TareRun
    from residual import (
        SensorConfig as SensorConfig,
        SensorWarning as SensorWarning,
        Status as Status,
        VirtualForceSensor as VirtualForceSensor,
        WrenchEstimate as WrenchEstimate,
    )
    from urdf import (
        NeedleTool as NeedleTool,
        Payload as Payload,
        Robot as Robot,
        load_lwr as load_lwr,
        load_urdf as load_urdf,
    )

for _name in ("foundation", "urdf", "residual", "identification", "groundtruth"):
    # Python takes the first match on its path: a user's script or folder of data with
    # one of these names may come first.
    _spec = find_spec(_name)
    _place = _spec and [*(_spec.submodule_search_locations or ()), _spec.origin][0]
    if _place and realpath(_place) != realpath(join(dirname(__file__), "..", _name)):
        raise ImportError(
            f"{_place} hides the package {_name!r} of needleforce. Rename it, or work "
            "in another folder"
        )

_NAMES_OF = {
    "foundation.errors": ("NeedleforceError",),
    "identification": (
        "Estimate",
        "Identifier",
        "LayerEstimate",
        "MixtureConfig",
        "PublishedConfig",
        "Rupture",
        "replay",
    ),
    "needleforce.insertion_events": ("SessionEvent", "session_events"),
    "needleforce.needle_channels": ("ChannelState",),
    "needleforce.needle_on_plan": ("PlanDeviation", "PlannedPath"),
    "needleforce.plan_file": ("PlanFileError", "read_plan"),
    "needleforce.recorder": ("Recorder", "RecorderError"),
    "needleforce.session": ("InsertionSession", "SessionEstimate"),
    "needleforce.session_replay": ("replay_session",),
    "needleforce.session_snapshot": (
        "InsertionError",
        "SessionSnapshot",
        "SnapshotFileError",
        "read_snapshot",
        "write_snapshot",
    ),
    "needleforce.tare_run": ("AutoTare", "TareRun"),
    "residual": (
        "SensorConfig",
        "SensorWarning",
        "Status",
        "VirtualForceSensor",
        "WrenchEstimate",
    ),
    "urdf": (
        "NeedleTool",
        "Payload",
        "Robot",
        "load_lwr",
        "load_urdf",
    ),
}
_MODULE_OF = {name: module for module, names in _NAMES_OF.items() for name in names}

__all__ = sorted(_MODULE_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for."""
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_MODULE_OF[name]), name)
    return value


def __dir__() -> list[str]:
    """Public names, imported or not."""
    return [*globals(), *__all__]
