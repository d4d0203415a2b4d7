"""Simulated insertions for rehearsal, demonstrations and benchmarks, beside the truth.

Only here do sessions and plans meet the ground truth. Needs the extra `demo`; all but
`tables` need `patient`, too.

Reading order: `tables` (an insertion as columns of a recording), `torso_case` (CT and
labels of an analytic torso), `patient` (a simulated arm over the patient of a plan),
`planned_insertion` (from a CT to a needle whose ruptures correct
the plan).
"""

from needleforce.simulation.patient import (
    insert_into_patient as insert_into_patient,
    touch_patient as touch_patient,
)
from needleforce.simulation.planned_insertion import (
    PlannedInsertion as PlannedInsertion,
    insert as insert,
)
from needleforce.simulation.tables import (
    needle_table as needle_table,
    signal_table as signal_table,
    tissue_table as tissue_table,
    truth_table as truth_table,
)
from needleforce.simulation.torso_case import write_torso_case as write_torso_case
