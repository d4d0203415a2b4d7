"""The application `needleforce`, and the groups of commands and options in its help."""

from cyclopts import App, Group, Parameter

LOGS = Group("A log: force, layers, pages", sort_key=1)
ARMS = Group("An arm", sort_key=2)
PATIENT = Group("A patient: from a CT to a registered plan", sort_key=3)
MACHINE = Group("This machine", sort_key=4)

LOG = Group("Log", sort_key=1)
OUTPUT = Group(
    "Output", help="What is written; without any, a summary alone.", sort_key=2
)
LIVE_OUTPUT = Group("Output", sort_key=2)
"""Output of the commands that do not print a summary alone."""
ROBOT = Group("Robot", sort_key=3)
SENSOR = Group("Sensor", sort_key=4)
TARE = Group("Tare", sort_key=5)
COLUMNS = Group(
    "Columns",
    help="COLUMNS is a column name, a pattern such as q{1..7} or q_*, or names "
    "separated by commas; a unit and a factor may follow, as in z:mm or fz:N:-1. What "
    "is not given is found by its usual names.",
    sort_key=6,
)


app = App(
    name="needleforce",
    help="Needle-tip force from a robot's joint torques, and the layers that the "
    "needle passes.\n\nBegin with `needleforce demo` (a simulated insertion), "
    "`needleforce force LOG` (an arm's log) or `needleforce identify LOG` (depth and "
    "force).",
    default_parameter=Parameter(negative=(), show_default=False),
    help_format="markdown",
    version_flags=["--version"],
    group_parameters=LOG,
    group_arguments=LOG,
)
app.register_install_completion_command(
    help="Install completion for bash, zsh or fish."
)
